"""Keys, signatures and the bundle of keys that a verifier trusts."""

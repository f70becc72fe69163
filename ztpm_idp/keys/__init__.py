"""The identity provider's private keys and its key ring."""

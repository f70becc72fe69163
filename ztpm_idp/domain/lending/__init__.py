"""Authority lent: attestation, tokens, delegation, mandates."""

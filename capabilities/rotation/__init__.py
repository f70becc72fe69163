"""Rotation of an identity provider's keys, and the trust bundle that follows from it."""

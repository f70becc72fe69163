"""Connections to the identity provider: revocation feed, conduct, asks, journal upload."""

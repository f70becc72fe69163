"""Durable journal, conduct of holders as seen here, and the proofs already used."""

"""The durable journal, what was seen of each holder's conduct, and the proofs already used."""

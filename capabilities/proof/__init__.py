"""Proofs of possession: one signature per request, or a keyed session for a stream."""

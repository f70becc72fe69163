"""Log of entries as others verify it: Merkle tree, signed notes, checkpoints and proofs."""

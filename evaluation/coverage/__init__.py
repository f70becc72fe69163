"""Coverage of the attacks: each cell of the paper's table, shown by taking primitives out of a running cell."""

"""Story end to end on an embedded cell: each step is done for real, and observed from outside."""

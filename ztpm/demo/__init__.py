"""The story end to end on an embedded cell: each step is told, done for real, and observed from outside."""

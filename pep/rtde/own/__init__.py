"""The lease of the cell's own tools, which gives way to a program's lease."""

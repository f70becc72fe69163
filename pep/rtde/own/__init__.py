"""The cell's own tools: their motions, and their lease, which gives way to a program's."""

"""Motions of the cell's tools: sent once, followed to their end, stopped at any time."""

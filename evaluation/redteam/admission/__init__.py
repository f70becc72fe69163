"""Admission point of the arena: everything that is said to its agents, and the tools beside it (docs/context.md)."""

"""Checks of each primitive, taken out of a process from outside. The product has no switch for any of it."""

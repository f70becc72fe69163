"""Certified search: bounds of the impact index over a whole motion."""

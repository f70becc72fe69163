"""Geometry of an assessment for people's eyes: the arm over time, what is around it, and where it decides."""

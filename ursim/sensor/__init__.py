"""Simulated sensors, which push signed frames of what they are told to see."""

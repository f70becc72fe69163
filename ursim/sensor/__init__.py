"""Simulated sensors, which push signed frames of a told scene."""

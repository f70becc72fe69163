"""Enforcement points, composed: the robot's gateway and the tool server in front of it."""

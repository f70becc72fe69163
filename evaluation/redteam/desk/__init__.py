"""Desk: a tool server without a robot, with and without a guard, and the folder on which all that it does is seen."""

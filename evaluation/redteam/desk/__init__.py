"""Desk: a tool server without a robot, guarded or not, and the folder in which its deeds are seen."""

"""Connections of our own to the robot: its state, its dashboard, its gripper."""

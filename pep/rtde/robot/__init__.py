"""Connections of our own to the robot: state, dashboard, gripper."""

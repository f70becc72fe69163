"""The robot: what RTDE clients say, what becomes of it, and the controller behind."""

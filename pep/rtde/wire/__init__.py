"""Bytes of the controller's ports: RTDE, primary, real-time and dashboard, read and written."""

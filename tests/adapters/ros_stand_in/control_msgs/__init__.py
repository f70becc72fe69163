"""Stand-in for the messages of ros2_control."""

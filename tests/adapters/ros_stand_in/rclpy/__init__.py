"""Stand-in for the part of rclpy that the node uses, where ROS 2 is not to be had.

Parameters come from the environment as JSON; goals come as JSON lines on standard input, and what the node publishes
and answers goes to standard output. Names and signatures are those of rclpy in ROS 2 Humble to Kilted.
"""


def init():
    """Nothing to begin."""


def try_shutdown():
    """Nothing to end."""

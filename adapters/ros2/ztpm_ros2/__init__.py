"""A ROS 2 action server that lets a planner move an arm under an agent's authority.

`goal` reads what a planner asks for, `follow` asks the gateway and tells how it ended; both know ROS messages by their
members alone. `node` is the one module that imports rclpy.
"""

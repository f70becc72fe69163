"""World of a request: robot, people and objects, and the recent acts of the arm."""

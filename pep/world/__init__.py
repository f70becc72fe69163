"""The world of a request: robot, people and objects, and what the arm did before."""

"""The scene: cell, objects, people, obstacles, and how far they are from the arm."""

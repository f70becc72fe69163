"""Scene: cell, objects, people, obstacles, and their distance from the arm."""

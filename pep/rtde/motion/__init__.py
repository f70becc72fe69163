"""Motions of the arm, of tools and programs alike: followed to their end, slowed, and stopped at any time."""

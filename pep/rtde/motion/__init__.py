"""Motions of the arm, whoever began them: followed to their end, slowed, and stopped at any time."""

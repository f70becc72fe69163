"""Compiled arithmetic: poses, distances, torques, laws of the index."""

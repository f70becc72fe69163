"""Rows of pushes: which question was told to which webhook."""

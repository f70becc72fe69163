"""Proof documents: the rows of an answer for the independent checker."""

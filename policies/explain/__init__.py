"""Explanations: the reasons of a decision, its remedies, the differences of two policy sets."""

"""Explanations: why a decision was made, what would change it, how two policy sets differ."""

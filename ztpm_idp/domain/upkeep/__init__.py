"""Upkeep of parties, tools and keys: suspended, restored, retired, replaced."""

"""Pages that people look at: what they have in common."""

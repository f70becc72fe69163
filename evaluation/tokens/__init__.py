"""Claims about tokens, shown."""

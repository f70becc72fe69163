"""What we claim about tokens, shown."""

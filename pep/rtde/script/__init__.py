"""URScript: grammar, canonical text, and the programs that may be assessed."""

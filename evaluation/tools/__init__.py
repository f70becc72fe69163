"""A guarded act beside the unguarded one: over HTTP, and as a call of a function."""

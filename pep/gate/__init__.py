"""The gate: every step from a request to its effect, and the records of both."""

"""Signed statements: one sealed form, and one module for each kind with `sign` and `open`."""

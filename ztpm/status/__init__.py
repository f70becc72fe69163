"""The page of a running cell for the user who runs it: its state, live, and a stop."""

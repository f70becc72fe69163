"""The page of a running cell, on loopback, for the user who runs it: how it stands, live, and a stop."""

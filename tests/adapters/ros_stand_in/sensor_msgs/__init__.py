"""Stand-in for the messages of sensors."""

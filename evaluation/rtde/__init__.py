"""Gateway beside a controller that is reached directly: the delay of a command, and lost commands."""

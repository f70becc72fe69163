"""The gateway beside a controller that is reached directly: what a command is later, and whether one is lost."""

"""The controller's ports, the one thread that ticks, and faults on request."""

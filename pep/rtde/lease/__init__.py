"""Motion lease: the right to move the robot now, and the connection that carries it."""

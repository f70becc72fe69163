"""The motion lease: who may move the robot now, and the connection that carries it."""

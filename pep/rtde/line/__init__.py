"""Lines of a lease: the client's bytes in, effects out, and the one writer to the controller."""

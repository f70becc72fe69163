"""The status page of a running cell: read-only, on loopback, for the user who runs it."""

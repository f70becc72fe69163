"""The embedded cell: its directory, its processes, and the supervision that keeps them running."""

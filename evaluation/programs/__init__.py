"""Thirty small programs in plain ur_rtde, each run under a lease as it is."""

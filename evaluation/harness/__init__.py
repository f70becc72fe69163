"""Harness: times cells in turns, runs campaigns, and reports their results."""

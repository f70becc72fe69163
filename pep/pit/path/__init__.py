"""Paths through joint space: straight ones, courses, lines of the tool."""

"""Enforcement point composed of its parts: the common ones, those that decide, and the guard of any tool server."""

"""Measurements behind our claims: each module makes one on a running cell and reports it."""

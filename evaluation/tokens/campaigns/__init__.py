"""Campaigns: each claim about tokens, tried many times."""

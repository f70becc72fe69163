"""Platforms and publishers whose word on agents counts: how they are stated, and where their keys come from."""

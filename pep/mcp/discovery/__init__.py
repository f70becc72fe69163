"""Proposals for a person to review: mappings of listed tools, and scopes of acts on record. Pure."""

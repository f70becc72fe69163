"""Pictures of motions, kept for a time by their digests."""

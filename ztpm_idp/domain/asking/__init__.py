"""Questions to people: asks, votes, openings."""

"""Questions to people: asks, votes, openings, and how an answer counts."""

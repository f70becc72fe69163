"""`ztpm policy`: policy sets checked, explained, compared, simulated and proven."""

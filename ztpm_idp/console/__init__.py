"""Console: pages on which people see what was lent, take it back, and read the ledger."""

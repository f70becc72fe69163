"""OAuth in the store: its tables, and the access of one transaction to them."""

"""Stop times on an embedded cell: measured, and told as a table, a file and a picture."""

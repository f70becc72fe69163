"""Ground floor of the composition: processes, files of a cell, locks, addresses, incidents."""

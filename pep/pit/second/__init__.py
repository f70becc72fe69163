"""Second engine: pinocchio and coal check the certified answer."""

"""Programs in a motion lease: the lease opened, the robot's ports brought to the program."""

"""Ground floor: errors, operations, ports to the outside, clocks, files, the stop model."""

"""The decision: policies, how their answers combine, and the one pure function `decide`."""

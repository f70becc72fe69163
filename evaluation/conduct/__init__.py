"""Trust and behaviour on simulated agents: what is claimed of them, measured."""

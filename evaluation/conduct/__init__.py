"""Trust and behaviour on simulated agents: our claims about them, measured."""

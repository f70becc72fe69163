"""Acts of a scenario: what each one is, and how it is done with no enforcement and before it."""

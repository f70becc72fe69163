"""What we claim, measured: each module makes one measurement on a running cell and says what it saw."""

"""The paper's 60 traces: their statistics, and each of them again before the gate of an arm."""

"""A live cell with people and agents, and measurements of its arm: for the demo and for evaluation."""

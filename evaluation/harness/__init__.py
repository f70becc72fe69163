"""The harness: times cells in turns, runs campaigns, and tells what they found."""

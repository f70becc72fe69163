"""Pages of questions for people in a browser."""

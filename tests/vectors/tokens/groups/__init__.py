"""The vectors by what they show."""

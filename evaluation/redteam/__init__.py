"""Red team: attempts that are forced on a running cell, and what they come to with and without enforcement."""

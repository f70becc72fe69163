"""Edge of every HTTP listener: deadlines, places by address, and logs that repeat once a minute."""

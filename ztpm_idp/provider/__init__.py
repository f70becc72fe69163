"""Provider at work: commands through the domain, and its statements, reads and answers."""

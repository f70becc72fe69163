"""The provider at work: commands through the domain, and what it publishes, reads and answers."""

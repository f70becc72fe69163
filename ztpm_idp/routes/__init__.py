"""The endpoints. Each parses strictly, calls the domain through the provider, and answers."""

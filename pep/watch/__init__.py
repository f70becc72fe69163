"""The watch over a moving arm, and the governor that slows it."""

"""The schema's history. `env.py` runs on a connection that the store hands over."""

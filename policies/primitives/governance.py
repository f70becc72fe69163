"""Domain ABG, agent behaviour governance: what an agent does over time. None is written yet."""

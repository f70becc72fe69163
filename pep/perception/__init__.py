"""Perception: frames signed by sensors, their order and age, and whether they agree."""

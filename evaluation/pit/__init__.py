"""Certified physics beside sampled distances, in one run."""

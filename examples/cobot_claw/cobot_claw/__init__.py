"""Cobot-Claw: four agents that hand a person parts with a robot arm, each act of theirs under that person's authority.

`ztpm claw "hand me the part"` starts the cell, the admission point and the agents, a process each.
"""

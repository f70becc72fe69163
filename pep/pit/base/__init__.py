"""Ground floor of the physics room: errors, motions, tiers, braking, the forms of input."""

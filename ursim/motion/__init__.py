"""The simulated arm: kinematics, dynamics, motions and safety limits."""

"""The robot model: kinematics, frames, calibration, what it holds, URDF import."""

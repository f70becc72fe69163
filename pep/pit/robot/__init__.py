"""Robot model: kinematics, frames, calibration, held object, URDF import."""

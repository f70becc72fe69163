"""The compiled engine: kinematics, distances, bounds and searches as loops that numba turns into machine code.

It runs without the interpreter's lock. The bounds are those of docs/physics.md (PHY-9, PHY-17); tests hold it to a slow
twin in numpy (`tests/model/pit`).
"""

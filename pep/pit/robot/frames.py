"""Frames as 4 x 4 matrices, for models that are built and not moved."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.robot.model import Vector
    from pep.pit.robot.urdf import Pose


def upright(axis: Floats) -> Floats:
    """Frame with the same origin and z along the axis; exact along x, y and z.

    It is the same frame where z is the axis.
    """
    side = np.zeros(3)
    side[int(np.abs(axis).argmin())] = 1.0
    return frame_on(axis, side, np.zeros(3))


def frame_on(axis: Floats, side: Floats, origin: Floats) -> Floats:
    """Z along `axis`, x as near to `side` as can be."""
    x = side - (side @ axis) * axis
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1], frame[:3, 2], frame[:3, 3] = x, np.cross(axis, x), axis, origin
    return frame


def matrix_of(pose: Pose) -> Floats:
    """The pose as a matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pinocchio.rpy.rpyToMatrix(*pose.rpy_rad), pose.xyz_m
    return matrix


def inverse(frame: Floats) -> Floats:
    """Inverse of the frame."""
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = frame[:3, :3].T, -frame[:3, :3].T @ frame[:3, 3]
    return back


def angles_of(turn: Floats) -> Vector:
    """Angles that spell a rotation.

    Each is taken from the remainder of the others, so that they spell it everywhere.
    """
    yaw = math.atan2(turn[1, 0], turn[0, 0])
    turn = pinocchio.rpy.rpyToMatrix(0.0, 0.0, -yaw) @ turn
    pitch = math.atan2(-turn[2, 0], turn[0, 0])
    turn = pinocchio.rpy.rpyToMatrix(0.0, -pitch, 0.0) @ turn
    return math.atan2(turn[2, 1], turn[2, 2]), pitch, yaw


def vector_of(numbers: Floats) -> Vector:
    """Three numbers as a tuple."""
    x, y, z = numbers.tolist()
    return x, y, z

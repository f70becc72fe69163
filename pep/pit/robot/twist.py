"""Turns and tool poses: rotation vectors as UR writes them, and a straight move with an even turn.

A constant twist is a straight line of the tool point and an even turn about one axis, both fixed in the base frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.robot.kinematics import link_frames

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats, Joints, Pose
    from pep.pit.robot.robot import Robot

TURN_LEVER_M: Final = 0.1  # PHY-18: U13 says 0.25 (4 rad/s per m/s); a shorter one is never slower
HALF_TURN_RAD: Final = math.pi - 0.01  # ours: nearer to half a turn it is not known which way round the tool turns
SMALL: Final = 1e-12  # a sine below which a turn is none, or half of one


def turned_by(vector: Floats) -> Floats:
    """The rotation matrix (3, 3) of a rotation vector (3,), rad."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < SMALL:
        return np.asarray(np.eye(3) + cross)
    half = math.sin(angle / 2) / (angle / 2)
    return np.asarray(np.eye(3) + math.sin(angle) / angle * cross + 0.5 * half * half * (cross @ cross))


def turn_of(rotation: Floats) -> Floats:
    """The rotation vectors (..., 3) of rotation matrices (..., 3, 3), each of at most half a turn."""
    twice = np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.sqrt((twice**2).sum(axis=-1))
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1)
    angle = np.arctan2(sine, cosine)
    scale = np.where(sine > SMALL, angle / np.where(sine > SMALL, sine, 1), 1)
    vector = 0.5 * scale[..., None] * twice
    # Half a turn has no sine: its axis is the only direction that R + 1 leaves.
    halves = (sine <= SMALL) & (cosine < 0)
    if halves.any():
        left = rotation + np.eye(3)
        column = np.linalg.norm(left, axis=-2).argmax(axis=-1)
        axis = np.take_along_axis(left, column[..., None, None], axis=-1)[..., 0]
        axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        vector = np.where(halves[..., None], math.pi * axis, vector)
    return np.asarray(vector)


def tool_pose(robot: Robot, q: Floats) -> tuple[Floats, Floats]:
    """Position (3,), m, and rotation (3, 3) of the tool in the base frame at joint angles (6,), rad."""
    rotation, origin = link_frames(robot, np.asarray(q, dtype=float)[None])
    return np.asarray(origin[0, -1] + rotation[0, -1] @ np.array(robot.tool.tcp_m)), np.asarray(rotation[0, -1])


@dataclass(frozen=True, slots=True, eq=False)
class Twist:
    """A tool pose and its course: after `s` it is `s * line` further and turned by `s * turn`.

    Attributes:
        position: at the start (3,), m.
        rotation: rotation at the start (3, 3).
        line: (3,), m per unit of s.
        turn: (3,), rad per unit of s, in the base frame.
    """

    position: Floats
    rotation: Floats
    line: Floats
    turn: Floats

    @staticmethod
    def between(robot: Robot, start: Joints, target: Pose) -> Twist:
        """Twist from the tool's place at `start` to `target` (m, rotation vector in rad)."""
        position, rotation = tool_pose(robot, np.array(start))
        goal = np.array(target[:3]), turned_by(np.array(target[3:]))
        return Twist(position, rotation, goal[0] - position, turn_of(goal[1] @ rotation.T))

    @property
    def way_m(self) -> float:
        """Length by which the tool's speed is measured: the line, or the turn at its lever where that takes longer."""
        return max(float(np.linalg.norm(self.line)), TURN_LEVER_M * float(np.linalg.norm(self.turn)))

    @property
    def rate(self) -> Floats:
        """Linear and angular velocity per unit of s (6,)."""
        return np.concatenate([self.line, self.turn])

    def at(self, s: float) -> tuple[Floats, Floats]:
        """Position and rotation at `s`."""
        return self.position + s * self.line, turned_by(s * self.turn) @ self.rotation

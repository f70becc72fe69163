"""Turns as rotation vectors, and a straight move of the tool with an even turn about one axis (PHY-18)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from pep.pit.checker.distances import Mat, Vec, length, minus, plus, product, transposed

TURN_LEVER_M: Final = 0.1  # PHY-18: at which a turn counts as a way
SMALL: Final = 1e-12  # a sine or angle below which a turn is none, or half of one
HALF: Final[Vec] = (math.pi, 0.0, 0.0)  # half a turn: about which axis is no matter here, since none is gone through


def turned_by(vector: Vec) -> Mat:
    """The rotation matrix of a rotation vector, rad."""
    angle = length(vector)
    x, y, z = vector
    first = math.sin(angle) / angle if angle >= SMALL else 1.0
    half = math.sin(angle / 2) / (angle / 2) if angle >= SMALL else 1.0
    second = 0.5 * half * half
    return (
        (1 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y),
        (second * x * y + first * z, 1 - second * (x * x + z * z), second * y * z - first * x),
        (second * x * z - first * y, second * y * z + first * x, 1 - second * (x * x + y * y)),
    )


def turn_of(m: Mat) -> Vec:
    """Rotation vector of a rotation matrix, rad; for half a turn, either of the two."""
    x, y, z = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    sine, cosine = 0.5 * length((x, y, z)), 0.5 * (m[0][0] + m[1][1] + m[2][2] - 1)
    if sine <= SMALL and cosine < 0:
        return HALF
    scale = 0.5 * (math.atan2(sine, cosine) / sine if sine > SMALL else 1.0)
    return (scale * x, scale * y, scale * z)


Pose = tuple[Vec, Mat]
"""Position (metre) and rotation of the tool in the base frame."""


def apart(goal: Pose, here: Pose) -> tuple[float, ...]:
    """Difference from `here` to `goal`: way (m) and turn (rad) in the base frame."""
    return (*minus(goal[0], here[0]), *turn_of(product(goal[1], transposed(here[1]))))


@dataclass(frozen=True, slots=True)
class CheckerTwist:
    """Straight and even move of the tool.

    After `s` it is `s * line` (m) farther and turned by `s * turn` (rad, in the base frame).
    """

    begin: Pose
    line: Vec
    turn: Vec

    @property
    def way_m(self) -> float:
        """Length by which the tool's speed is measured (PHY-18)."""
        return max(length(self.line), TURN_LEVER_M * length(self.turn))

    @property
    def rate(self) -> tuple[float, ...]:
        """Linear and angular velocity per unit of s."""
        return (*self.line, *self.turn)

    def at(self, s: float) -> Pose:
        """Pose of the tool at `s`."""
        x, y, z = self.turn
        return plus(self.begin[0], self.line, s), product(turned_by((s * x, s * y, s * z)), self.begin[1])


def between(begin: Pose, goal: Pose) -> CheckerTwist:
    """Twist from one pose of the tool to another."""
    x, y, z, u, v, w = apart(goal, begin)
    return CheckerTwist(begin, (x, y, z), (u, v, w))

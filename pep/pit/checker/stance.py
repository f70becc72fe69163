"""Arm at one configuration as the tool needs it: pose, Jacobian with its inverse, and its bend."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.pit.checker.arm import frames
from pep.pit.checker.distances import ORIGIN, cross, minus, plus, turned
from pep.pit.checker.robot import JOINTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.distances import Vec
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.twist import Pose

INVERSE_OFF: Final = 1e-9  # largest entry of 1 - G J that an inverse may leave: rounding, far from any singularity
LINEAR: Final = 3  # parts of a velocity, and rows of a Jacobian, before the angular ones

Six = tuple[float, ...]
Matrix = tuple[Six, ...]  # six rows of six


@dataclass(frozen=True, slots=True)
class CheckerStance:
    """The arm at `q`.

    Attributes:
        q: joint angles, rad.
        pose: of the tool.
        axes, origins: of the joints, in the base frame.
        inverse: joint rates by the tool's velocity (linear, then angular).
        gain: per joint how far a linear and an angular deviation of 1 go, at most.
    """

    q: Six
    pose: Pose
    axes: tuple[Vec, ...]
    origins: tuple[Vec, ...]
    inverse: Matrix
    gain: tuple[tuple[float, float], ...]

    def rates(self, velocity: Sequence[float]) -> Six:
        """Joint rates for this velocity of the tool."""
        return times(self.inverse, velocity)

    def bend(self, rates: Sequence[float]) -> Matrix:
        """Derivative of the Jacobian while the joints turn at these rates; six rows."""
        point = self.pose[0]
        turning = [(x * r, y * r, z * r) for (x, y, z), r in zip(self.axes, rates, strict=True)]
        # Of the link that carries each axis; the velocity of p is spin x p + moment.
        spins, moments = [ORIGIN], [ORIGIN]
        for joint in range(JOINTS):
            spins.append(plus(spins[joint], turning[joint]))
            moments.append(plus(moments[joint], cross(self.origins[joint], turning[joint])))
        velocity = plus(cross(spins[JOINTS], point), moments[JOINTS])
        columns = []
        for joint in range(JOINTS):
            origin, axis = self.origins[joint], self.axes[joint]
            of_origin = plus(cross(spins[joint], origin), moments[joint])
            bent = cross(spins[joint], axis)
            linear = plus(cross(bent, minus(point, origin)), cross(axis, minus(velocity, of_origin)))
            columns.append((*linear, *bent))
        return tuple(zip(*columns, strict=True))


def times(matrix: Matrix, vector: Sequence[float]) -> Six:
    """Matrix times vector."""
    a, b, c, d, e, f = vector
    return tuple(r[0] * a + r[1] * b + r[2] * c + r[3] * d + r[4] * e + r[5] * f for r in matrix)


def stance(robot: CheckerRobot, q: Sequence[float]) -> CheckerStance | None:
    """The arm at `q`, or None where its Jacobian has no inverse of any use."""
    turns, origins = frames(robot, q)
    point = plus(turned(turns[JOINTS], robot.tcp.a), origins[JOINTS])
    axes = tuple((x[2], y[2], z[2]) for x, y, z in turns[1:])
    columns = [(*cross(axis, minus(point, at)), *axis) for axis, at in zip(axes, origins[1:], strict=True)]
    found = inverse(tuple(zip(*columns, strict=True)))
    if found is None:
        return None
    gain = tuple((math.hypot(*row[:LINEAR]), math.hypot(*row[LINEAR:])) for row in found)
    return CheckerStance(tuple(q), (point, turns[JOINTS]), axes, tuple(origins[1:]), found, gain)


def inverse(matrix: Matrix) -> Matrix | None:
    """Inverse by elimination with the largest pivot of each column; None where it fails to rounding."""
    rows = [[*row, *(1.0 if k == j else 0.0 for j in range(JOINTS))] for k, row in enumerate(matrix)]
    for column in range(JOINTS):
        best = max(range(column, JOINTS), key=lambda k: abs(rows[k][column]))
        pivot = rows[best][column]
        if not abs(pivot) > 0:
            return None
        rows[column], rows[best] = rows[best], rows[column]
        own = rows[column] = [x / pivot for x in rows[column]]
        for k in range(JOINTS):
            share = rows[k][column]
            if k != column and share:
                rows[k] = [x - share * y for x, y in zip(rows[k], own, strict=True)]
    found = tuple(tuple(row[JOINTS:]) for row in rows)
    for j in range(JOINTS):
        for k, off in enumerate(times(found, [row[j] for row in matrix])):
            if not abs(off - (k == j)) <= INVERSE_OFF:
                return None
    return found

"""Joint angles for a place in metres, by the arm's own kinematics, with the tool pointing down."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit import Robot
from pep.pit.robot.inverse_kinematics import Stance, solved, stance

if TYPE_CHECKING:
    from collections.abc import Sequence

MODEL: Final = "ur3e"
FRONT: Final = (0.0, -1.62, 1.25, -1.2, -1.57, 0.0)
"""Pose from which every search begins: the tool points down in front of the arm (rad)."""
STEP_M: Final = 0.03
"""Newton's method converges over steps of this length everywhere the tests went."""


class OutOfReachError(ValueError):
    """A place that the arm does not reach with its tool pointing down."""


@cache
def _begun() -> tuple[Robot, Stance]:
    robot = Robot.load(MODEL)
    return robot, stance(robot, np.array(FRONT))


def tool_at(q_rad: Sequence[float]) -> tuple[float, float, float]:
    """Middle of the fingers at six joint angles (rad), m in the base frame."""
    x, y, z = map(float, stance(_begun()[0], np.array(q_rad, dtype=float)).position)
    return x, y, z


def joints_at(x_m: float, y_m: float, z_m: float) -> list[float]:
    """Six joint angles in rad, on the grid of a request, with the tool's centre at that place, pointing down.

    Args:
        x_m: in the robot's base frame.
        y_m: likewise.
        z_m: likewise.

    Raises:
        OutOfReachError: no such angles were found.
    """
    if not all(math.isfinite(number) for number in (x_m, y_m, z_m)):
        raise OutOfReachError("a place that is no number")
    robot, here = _begun()
    goal, start = np.array([x_m, y_m, z_m]), here.position
    steps = max(1, math.ceil(float(np.linalg.norm(goal - start)) / STEP_M))
    if steps > 2 / STEP_M:  # 2 m: farther than any arm of this size reaches
        raise OutOfReachError(f"{x_m}, {y_m}, {z_m} m is out of reach")
    q = here.q
    for step in range(1, steps + 1):
        found = solved(robot, (start + (goal - start) * step / steps, here.rotation), q)
        if found is None:
            raise OutOfReachError(f"{x_m}, {y_m}, {z_m} m is out of reach")
        q = found.q
    return [round(float(angle), 6) for angle in q]

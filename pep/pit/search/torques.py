"""Torque of every joint at some places of a path, by the rigid-body model: sampled, with no proof.

What holds the arm, what s'' asks and what s' squared asks are computed once; any timing of the path is a sum of these.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio

from pep.pit.search.kernel.arithmetic.joint_torques import masses_of, torques

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters


def carried_kg(robot: Robot, cell: CellParameters) -> float:
    """Mass at the tool point that is no body of the robot: the cell's constant load."""
    return robot.model.payload_limit_kg if cell.payload_kg is None else cell.payload_kg


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def _loaded(robot: Robot, carried: float) -> Any:
    """Pinocchio's model with the load."""
    if not carried > 0:
        return robot.pinocchio
    model = pinocchio.Model(robot.pinocchio)
    part = pinocchio.Inertia(carried, np.array(robot.tool.tcp_m), np.zeros((3, 3)))
    model.inertias[len(robot.model.joints)] += part
    return model


@lru_cache(maxsize=64)  # likewise
def masses_with(robot: Robot, carried: float) -> Any:
    """Links as rigid bodies with so much at the tool point, kg (`...kernel.arithmetic.joint_torques.Masses`)."""
    return masses_of(_loaded(robot, carried))


class Torques:
    """Torques of every joint at some places of a path, with the load, for any timing."""

    def __init__(self, robot: Robot, cell: CellParameters, q: Floats, dq: Floats, ddq: Floats) -> None:
        """Computes them at configurations `q` (n, 6), rad.

        `dq` and `ddq` (n, 6) are the derivatives by the path parameter.
        """
        carried = carried_kg(robot, cell)
        # Rows that lie apart in memory would be another type, compiled when the first question has it.
        rows = map(np.ascontiguousarray, (q, dq, ddq))
        self._hold, self._push, self._swing = torques(masses_with(robot, carried), *rows)
        self._limits_nm = robot.torque_limits_nm

    def ratio(self, rate: Floats, *, forward: float, backward: float) -> float:
        """Worst torque by limit over the places: braking, coasting or accelerating, at rest or at the full rate.

        Coasting lies between the other two, so it is never the worst. No number anywhere is the worst of all.

        Args:
            rate: s' at each place, (n,), 1/s.
            forward: greatest s'' that speeds up, 1/s^2.
            backward: greatest that slows down.
        """
        both = np.empty((2, *self._hold.shape))
        both[0] = self._hold
        both[1] = self._hold + self._swing * (rate**2)[:, None]
        hardest = np.maximum(np.abs(both + self._push * forward), np.abs(both - self._push * backward))
        worst = float((hardest / self._limits_nm).max(initial=0))
        return math.inf if math.isnan(worst) else worst

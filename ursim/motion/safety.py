"""Safety limits of the installation: limits that programs are slowed down for, and limits that end everything.

As in the vendor's e-Series manuals: a running program is slowed so that it keeps each limit less its tolerance; what
exceeds a limit all the same is a violation, and the arm stops and loses its power (stop category 0). Only moves whose
way is planned can be slowed. A stream of targets or speeds is followed as it comes, so that it may end in a violation.

Forces, power and the limits on stopping are not watched: nothing touches this arm, and the vendor does not publish how
it computes the rest.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from ursim.motion.motion import Brake, MoveJoints, MoveTool
from ursim.motion.robot import TICK_S, Cause, SafetyMode

if TYPE_CHECKING:
    from ursim.motion.robot import Robot


class Quantities(NamedTuple):
    """Limited quantities: speeds of the faster of tool centre point and flange, and of the elbow; momentum.

    The momentum is that of arm and payload.
    """

    tool_speed_m_s: float
    elbow_speed_m_s: float
    momentum_kg_m_s: float


CAUSES: Final = (Cause.TOOL_SPEED, Cause.ELBOW_SPEED, Cause.MOMENTUM)  # of each quantity in turn
# Customary for an e-Series arm whose safety configuration nobody has changed. No table of the vendor's was found; an
# integrator sets what the risk assessment asks for. A violation is shown by tests, no figure rests on these values.
NORMAL: Final = Quantities(1.5, 1.5, 25.0)
REDUCED: Final = Quantities(0.75, 0.75, 10.0)
TOLERANCE: Final = Quantities(0.05, 0.05, 3.0)  # UR3e user manual, safety functions: 50 mm/s and 3 kg m/s
REDUCED_AFTER_S: Final = 0.5  # UR3e user manual, modes: until the limits of reduced mode apply, to slow down in


class SafetyLimits:
    """Watches one robot against its limits. Called by the tick thread alone."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._before: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._lowered = 0.0

    def slow(self) -> None:
        """The drive goes no faster than the limits allow; `time_scale_source` says which of them, if any."""
        robot, drive = self._robot, self._robot.drive
        self._lower()
        drive.allowed, robot.slowed_for = 1.0, Cause.NOT_SLOWED
        if drive.scaling <= 0.0 or not isinstance(drive.motion, MoveJoints | MoveTool):
            self._before = (0.0, 0.0, 0.0)
            return
        # Everything limited is proportional to the scaling: at full speed it would be this.
        now = tuple(value / drive.scaling for value in _measured(robot))
        before, self._before = self._before, now
        limits = self._aimed()
        for cause, value, last, limit, tolerance in zip(CAUSES, now, before, limits, TOLERANCE, strict=True):
            coming = value + max(0.0, value - last)  # as much more in this tick as in the last
            if coming * drive.allowed > limit - tolerance:
                drive.allowed, robot.slowed_for = (limit - tolerance) / coming, cause

    def exceeded(self) -> Cause | None:
        """Limit that a motion has exceeded, if any. A brake exceeds none."""
        robot = self._robot
        if robot.drive.motion is None or isinstance(robot.drive.motion, Brake):
            return None
        watched = REDUCED if self._lowered >= 1.0 else NORMAL
        for cause, value, limit in zip(CAUSES, _measured(robot), watched, strict=True):
            if value > limit:
                return cause
        return None

    def _aimed(self) -> tuple[float, ...]:
        """Limits that moves are slowed down to.

        In reduced mode they fall by and by, so that moves brake and do not jump.
        """
        part = self._lowered
        return tuple(a + part * (b - a) for a, b in zip(NORMAL, REDUCED, strict=True))

    def _lower(self) -> None:
        """One tick nearer to reduced mode's limits, or back; violations of them count once they are reached."""
        step = TICK_S / REDUCED_AFTER_S if self._robot.safety is SafetyMode.REDUCED else -TICK_S / REDUCED_AFTER_S
        self._lowered = max(0.0, min(1.0, self._lowered + step))


def _measured(robot: Robot) -> Quantities:
    if robot.drive.now.at_rest:
        return Quantities(0.0, 0.0, 0.0)
    tool = max(math.hypot(*robot.tool_speed()[:3]), math.hypot(*robot.flange_speed()[:3]))
    return Quantities(tool, math.hypot(*robot.elbow()[1]), robot.momentum())

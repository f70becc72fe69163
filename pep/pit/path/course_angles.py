"""Exact joint angles of a course: on a line of the tool, and beyond its end along the joints' tangent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.errors import MotionError
from pep.pit.robot.inverse_kinematics import solved

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.twist import Twist


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The joint angles of a course at each place.

    Attributes:
        twist: the line of the tool by the course's own parameter, or None when there is none.
        until: end of the line, s; 0 without one.
        q, dq: joint angles there, (6,), rad, and their derivative by s, which is the tangent's.
    """

    twist: Twist | None
    until: float
    q: Floats
    dq: Floats

    def at(self, robot: Robot, s: float, near: Floats) -> tuple[Floats, Floats]:
        """Joint angles (6,) at `s` and their derivative by s; `near` is a configuration close to them.

        Raises:
            MotionError: `PHYSICS_FAULT`, a proven line is not found again.
        """
        if self.twist is not None and s <= self.until:
            here = solved(robot, self.twist.at(s), near)
            if here is None:
                raise MotionError("PHYSICS_FAULT", "a proven line was not found again")
            return here.q, np.asarray(np.linalg.solve(here.jacobian, self.twist.rate))
        return self.q + (s - self.until) * self.dq, self.dq

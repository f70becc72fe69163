"""A circle through three points: where `movec` leads the tool."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from ursim.motion.motion import MotionError, MoveTool
from ursim.motion.spatial import Frame, Rotation, Triple, add, compose, cross, from_vector, rotate, to_vector, transpose

if TYPE_CHECKING:
    from ursim.motion.arm import Arm, Joints

FLATTEST: Final = 1e-6  # sine of the angle at the way point below which three points are on a line


class MoveArc(MoveTool):
    """Round a circle from where the tool is through `via` to `target`, rest to rest.

    A move that was interrupted goes on along the same circle, to which it comes back by and by.

    Args:
        arm: the kinematics.
        tcp: the tool centre point in the flange frame.
        start: joint angles at rest.
        via: a point of the circle, in the base frame.
        target: the tool's pose to reach.
        speed_m_s: of the tool, along the arc.
        acceleration_m_s2: of the tool.
        fixed: the tool keeps its orientation to the arc's tangent, and that of `target` does not count; else it turns
            to that of `target` on the way.

    Raises:
        MotionError: there is no circle through the three points.
    """

    def __init__(
        self,
        arm: Arm,
        tcp: Frame,
        start: Joints,
        via: Triple,
        target: Frame,
        *,
        speed_m_s: float,
        acceleration_m_s2: float,
        fixed: bool,
    ) -> None:
        first = arm.tool(start, tcp)
        self._centre, self._axis = _circle(first[0], via, target[0])
        self._radius = math.dist(self._centre, target[0])
        self._fixed = fixed
        self._aside: Triple = (0.0, 0.0, 0.0)
        self._askew: Triple = (0.0, 0.0, 0.0)
        if fixed:
            target = (target[0], compose(self._turned(self._angle(first[0], target[0])), first[1]))
        super().__init__(arm, tcp, start, target, speed_m_s=speed_m_s, acceleration_m_s2=acceleration_m_s2)

    def restart(self, q: Joints) -> None:
        """Plans the rest of the arc again from rest at `q`."""
        self._from = self._arm.tool(q, self._tcp)
        self._swept = self._angle(self._from[0], self.target[0])
        self._turn = to_vector(compose(self.target[1], transpose(self._from[1])))
        # An arm that braked is beside the circle, and comes back to it on the rest of the way.
        self._aside = self._askew = (0.0, 0.0, 0.0)
        position, rotation = self._pose(0.0)
        self._aside = _minus(self._from[0], position)
        self._askew = to_vector(compose(self._from[1], transpose(rotation)))
        turning = 0.0 if self._fixed else math.hypot(*self._turn) * self.TURN_LEVER_M
        self._plan(max(self._radius * self._swept, turning))

    def _pose(self, part: float) -> Frame:
        # Told back from the target, which is so reached exactly.
        left = self._turned((part - 1.0) * self._swept)
        position = add(self._centre, rotate(left, _minus(self.target[0], self._centre)))
        x, y, z = self._aside
        position = add(position, ((1.0 - part) * x, (1.0 - part) * y, (1.0 - part) * z))
        if self._fixed:
            rx, ry, rz = self._askew
            back = from_vector(((1.0 - part) * rx, (1.0 - part) * ry, (1.0 - part) * rz))
            return position, compose(back, compose(left, self.target[1]))
        rx, ry, rz = self._turn
        return position, compose(from_vector((part * rx, part * ry, part * rz)), self._from[1])

    def _turned(self, angle_rad: float) -> Rotation:
        x, y, z = self._axis
        return from_vector((angle_rad * x, angle_rad * y, angle_rad * z))

    def _angle(self, here: Triple, there: Triple) -> float:
        """The angle from `here` on to `there` in the arc's sense, from 0 to a whole turn."""
        a, b = _minus(here, self._centre), _minus(there, self._centre)
        return math.atan2(_dot(cross(a, b), self._axis), _dot(a, b)) % math.tau


def _circle(a: Triple, b: Triple, c: Triple) -> tuple[Triple, Triple]:
    """Centre, and axis such that the way from `a` round to `c` meets `b` first."""
    ab, ac = _minus(b, a), _minus(c, a)
    normal = cross(ab, ac)
    n2, ab2, ac2 = _dot(normal, normal), _dot(ab, ab), _dot(ac, ac)
    if not n2 > FLATTEST * FLATTEST * ab2 * ac2:
        raise MotionError("there is no circle through these points")
    p, q = cross(normal, ab), cross(ac, normal)
    x, y, z = ((ac2 * u + ab2 * v) / (2.0 * n2) for u, v in zip(p, q, strict=True))
    length = math.sqrt(n2)
    return add(a, (x, y, z)), (normal[0] / length, normal[1] / length, normal[2] / length)


def _minus(a: Triple, b: Triple) -> Triple:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

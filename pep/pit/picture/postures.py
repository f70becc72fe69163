"""Postures of the arm at instants of a motion, and its nearest points to bodies: for display only.

No index comes from here. The positions are those of the answer: the same kinematics, the same profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.assessment.dispatch import drive_of, joint_moves, line_drives
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointPath,
    JointTrajectory,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
    profile_of,
)
from pep.pit.geometry.clearance import segment_box, segment_hull, segment_segment
from pep.pit.geometry.hull import hull_of
from pep.pit.geometry.solids import rotation_of
from pep.pit.path.timed_curve import curve_of
from pep.pit.robot.kinematics import link_frames
from pep.pit.scene.scene import Box, Capsule, Convex, Sphere
from pep.pit.search.blended_course import blended_drives
from pep.pit.search.question import as_run
from pep.pit.search.timed_course import TimedCourse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pep.pit.base.motion import Floats, Joints, Motion, Run
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Shape, Vector
    from pep.pit.search.timed_course import Drive

APART_M: Final = 1e-9  # float64 rounding: nearer than this there is no direction, and the axes cross
STILL: Final = np.zeros(6)  # six joints
"""Speed and stray of joints that do not move."""


@dataclass(frozen=True, slots=True)
class PostureCapsule:
    """Capsule of the robot in the base frame.

    Name, link (0 is the base), both ends and the radius, m.
    """

    name: str
    link: int
    a_m: Vector
    b_m: Vector
    radius_m: float


@dataclass(frozen=True, slots=True)
class Posture:
    """The arm at one instant, `t_s` after the motion began."""

    t_s: float
    q_rad: tuple[float, ...]
    parts: tuple[PostureCapsule, ...]
    tcp_m: Vector


@dataclass(frozen=True, slots=True)
class Nearest:
    """Nearest points of a part's and a thing's surface, and the signed clearance (core distance less radii)."""

    on_part_m: Vector
    on_thing_m: Vector
    clearance_m: float


@dataclass(frozen=True, slots=True)
class RouteStretch:
    """Part of a motion.

    Attributes:
        duration_s: of it.
        q: the joint angles (6,), rad, at a time of it.
        fastest_rad_s: proven bound on the speed of each joint, (6,).
        stray_rad: proven bound on the distance of each joint from `q`, (6,).
    """

    duration_s: float
    q: Callable[[float], Floats]
    fastest_rad_s: Floats
    stray_rad: Floats


@dataclass(frozen=True, slots=True)
class MotionPostures:
    """Motion as its stretches, one after the other; none for a motion without the arm.

    `whole` is whether the stretches are all of it: of a cut corner nobody knows the way.
    """

    robot: Robot
    stretches: tuple[RouteStretch, ...]
    whole: bool = True

    @property
    def duration_s(self) -> float:
        """Time from the first movement to rest."""
        return sum(stretch.duration_s for stretch in self.stretches)

    def postures(self, times_s: Iterable[float]) -> tuple[Posture, ...]:
        """The arm at these times after the start, s; beyond the end it stands at the end."""
        times = list(times_s)
        if not (self.stretches and times):
            return ()
        q = np.array([self._q(t) for t in times])
        rotation, origin = link_frames(self.robot, q)
        return tuple(
            _placed(self.robot, t, angles, turned, moved)
            for t, angles, turned, moved in zip(times, q, rotation, origin, strict=True)
        )

    def margin_m(self, times_s: Sequence[float]) -> float | None:
        """Bound on the way of any part from its nearest posture: capsules widened by it hold the arm ([STM-25]).

        No joint is faster than its proven bound, and none carries a part's ends farther than its reach. So between two
        drawn instants each part is nearer to one of them than half of the time allows.

        Args:
            times_s: of the drawn postures, rising, from the start to the end.

        Returns:
            Metres; None where the stretches are not all of the motion.
        """
        if not self.whole:
            return None
        reach = self.robot.reach[: self.robot.world_bodies]
        turned = [self._turned(low, high) for low, high in pairwise(times_s)] or [self._turned(0.0, 0.0)]
        return float((reach @ np.max(turned, axis=0)).max())

    def _turned(self, low_s: float, high_s: float) -> Floats:
        """Angle (6,) by which each joint may differ from that at the nearer of two instants, rad."""
        begun, most = 0.0, np.zeros(len(self.robot.model.joints))
        for stretch in self.stretches:
            if begun <= high_s and low_s <= begun + stretch.duration_s:
                most = np.maximum(most, stretch.fastest_rad_s * (high_s - low_s) / 2 + stretch.stray_rad)
            begun += stretch.duration_s
        return most

    def _q(self, t_s: float) -> Floats:
        left = t_s
        for stretch in self.stretches[:-1]:
            if left <= stretch.duration_s:
                return stretch.q(left)
            left -= stretch.duration_s
        return self.stretches[-1].q(min(left, self.stretches[-1].duration_s))


def posture_at(robot: Robot, q_rad: Sequence[float]) -> Posture:
    """The arm at six joint angles, rad, at time 0."""
    q = np.array([q_rad], dtype=float)
    rotation, origin = link_frames(robot, q)
    return _placed(robot, 0.0, q[0], rotation[0], origin[0])


def _placed(robot: Robot, t_s: float, q: Floats, rotation: Floats, origin: Floats) -> Posture:
    def placed(link: int, point: Vector) -> Vector:
        return _vector(rotation[link] @ np.array(point) + origin[link])

    parts = tuple(
        PostureCapsule(c.name, c.link, placed(c.link, c.a_m), placed(c.link, c.b_m), c.radius_m) for c in robot.capsules
    )
    return Posture(t_s, tuple(q.tolist()), parts, placed(len(robot.model.joints), robot.tool.tcp_m))


def route_of(robot: Robot, motion: Motion, cell: CellParameters, *, perception_age_s: float) -> MotionPostures:
    """Route of the arm.

    Args:
        robot: the arm, its tool and what that holds.
        motion: that was assessed.
        cell: the arm's stop: a held speed goes on until it has ended.
        perception_age_s: of the view; until it has stopped, a stream goes on, too.

    Raises:
        PitError: a motion that could not be assessed either.
    """
    match motion:
        case MoveJ() | SpeedJ():
            stretches = [_straight(as_run(motion, cell))]
        case JointPath():
            stretches = [_straight(as_run(move, cell)) for move in joint_moves(motion)]
        case MoveL() | SpeedL() | ServoJ():
            drive = drive_of(robot, motion, cell, perception_age_s=perception_age_s, check_time=_unhurried)
            stretches = [_driven(motion.start, drive)]
        case LinePath():
            stretches = [_driven(start, drive) for start, drive in line_drives(robot, motion, check_time=_unhurried)]
        case JointTrajectory():
            curve = curve_of(motion)
            fastest = np.abs(curve.v).max(axis=0)  # between two nodes a speed changes evenly
            stretches = [RouteStretch(curve.duration_s, lambda t: curve.at(t)[0], fastest, STILL)]
        case BlendedPath():
            drives = blended_drives(robot, motion, check_time=_unhurried)
            # Whole legs: of a corner it is not known how it is cut.
            legs = [(start, each) for start, each in drives if not isinstance(each, TimedCourse) or each.least_s > 0]
            stretches = [_driven(start, each) for start, each in legs]
        case GripperMove():
            stretches = [_still(motion.q)]
        case OutputSet():
            stretches = []
        case _:
            assert_never(motion)
    return MotionPostures(robot, tuple(stretches), whole=not isinstance(motion, BlendedPath))


def _unhurried() -> None:
    """Ends at no time: the same was computed in time before."""


def _straight(run: Run) -> RouteStretch:
    profile = profile_of(run)
    if profile is None:
        return _still(run.start)
    start, way = np.array(run.start), np.array(run.target) - np.array(run.start)
    fastest = np.abs(way) * (profile.peak_rad_s / profile.way_rad)
    return RouteStretch(profile.duration_s, lambda t: np.asarray(start + profile.at(t)[0] * way), fastest, STILL)


def _driven(start: Joints, drive: Drive) -> RouteStretch:
    if not isinstance(drive, TimedCourse):
        return _still(start)
    course, profile = drive.course, drive.profile
    return RouteStretch(
        profile.duration_s,
        lambda t: course.q(min(profile.at(t)[0], 1.0)),
        drive.joint_speeds_rad_s(profile).max(axis=0),
        course.cells.stray.max(axis=0),
    )


def _still(q: Joints) -> RouteStretch:
    return RouteStretch(0.0, lambda _: np.array(q), STILL, STILL)


def nearest(part: PostureCapsule, shape: Shape) -> Nearest:
    """Nearest points of the two surfaces."""
    a, b = np.array([part.a_m]), np.array([part.b_m])
    match shape:
        case Capsule(c, d, radius):
            on_axis, on_core = segment_segment(a, b, np.array([c]), np.array([d]))
        case Sphere(center, radius):
            on_axis, on_core = segment_segment(a, b, np.array([center]), np.array([center]))
        case Box(center, half, quaternion):
            radius = 0.0
            on_axis, on_core = segment_box(a, b, np.array([center]), rotation_of(quaternion)[None], np.array([half]))
        case Convex(vertices, radius):
            on_axis, on_core = segment_hull(a, b, hull_of(vertices))
        case _:
            assert_never(shape)
    gap = on_core[0] - on_axis[0]
    far = float(np.linalg.norm(gap))
    way = gap / far if far > APART_M else np.zeros(3)
    return Nearest(
        _vector(on_axis[0] + part.radius_m * way),
        _vector(on_core[0] - radius * way),
        far - part.radius_m - radius,
    )


def _vector(point: Floats) -> Vector:
    x, y, z = point.tolist()
    return (x, y, z)

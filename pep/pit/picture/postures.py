"""Postures of the arm at instants of a motion, and its nearest points to bodies: for display only.

No index comes from here. The positions are those of the answer: the same kinematics, the same profile.
"""

from __future__ import annotations

from dataclasses import dataclass
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
    """Part of a motion: its duration, and the joint angles (6,), rad, at a time of it."""

    duration_s: float
    q: Callable[[float], Floats]


@dataclass(frozen=True, slots=True)
class MotionPostures:
    """Motion as its stretches, one after the other; none for a motion without the arm."""

    robot: Robot
    stretches: tuple[RouteStretch, ...]

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
            stretches = [RouteStretch(curve.duration_s, lambda t: curve.at(t)[0])]
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
    return MotionPostures(robot, tuple(stretches))


def _unhurried() -> None:
    """Ends at no time: the same was computed in time before."""


def _straight(run: Run) -> RouteStretch:
    profile = profile_of(run)
    if profile is None:
        return _still(run.start)
    start, way = np.array(run.start), np.array(run.target) - np.array(run.start)
    return RouteStretch(profile.duration_s, lambda t: np.asarray(start + profile.at(t)[0] * way))


def _driven(start: Joints, drive: Drive) -> RouteStretch:
    if not isinstance(drive, TimedCourse):
        return _still(start)
    course, profile = drive.course, drive.profile
    return RouteStretch(profile.duration_s, lambda t: course.q(min(profile.at(t)[0], 1.0)))


def _still(q: Joints) -> RouteStretch:
    return RouteStretch(0.0, lambda _: np.array(q))


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

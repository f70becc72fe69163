"""Where every part of the arm is at instants of a motion, and where it is nearest to something: to show, not to judge.

No index comes from here. The positions are those of the answer: the same kinematics, the same profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.clearance import segment_box, segment_segment
from pep.pit.kinematics import link_frames
from pep.pit.motion import GripperMove, MoveJ, OutputSet, SpeedJ, profile_of
from pep.pit.question import as_run
from pep.pit.scene import Box, Capsule, Sphere
from pep.pit.solids import rotation_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats, Motion
    from pep.pit.robot import Robot
    from pep.pit.scene import Shape, Vector

APART_M: Final = 1e-9  # float64 rounding: nearer than this there is no direction, and the axes cross


@dataclass(frozen=True, slots=True)
class Part:
    """A capsule of the robot in the base frame: its name, its link (0 is the base), both ends and the radius, m."""

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
    parts: tuple[Part, ...]
    tcp_m: Vector


@dataclass(frozen=True, slots=True)
class Nearest:
    """Where a part's surface and a thing's surface are nearest, and the signed clearance (core distance less radii)."""

    on_part_m: Vector
    on_thing_m: Vector
    clearance_m: float


def duration_s(motion: Motion, cell: CellParameters) -> float:
    """Time from the first movement to rest, the cell's own stop included; 0 for what does not move the arm."""
    match motion:
        case MoveJ() | SpeedJ():
            profile = profile_of(as_run(motion, cell))
            return 0.0 if profile is None else profile.duration_s
        case GripperMove() | OutputSet():
            return 0.0
        case _:
            assert_never(motion)


def postures(robot: Robot, motion: Motion, cell: CellParameters, times_s: Iterable[float]) -> tuple[Posture, ...]:
    """The arm at these times; none for a motion that has nothing to do with the arm.

    Args:
        robot: the arm, its tool and what that holds.
        motion: as it was asked about.
        cell: how the arm stops.
        times_s: seconds after the start; beyond the end the arm stands at the end.
    """
    times = list(times_s)
    match motion:
        case MoveJ() | SpeedJ():
            run = as_run(motion, cell)
            profile = profile_of(run)
            start, way = np.array(run.start), np.array(run.target) - np.array(run.start)
            q = np.array([start + (0.0 if profile is None else profile.at(t)[0]) * way for t in times])
        case GripperMove():
            q = np.array([motion.q for _ in times])
        case OutputSet():
            return ()
        case _:
            assert_never(motion)
    return _at(robot, q, times) if times else ()


def _at(robot: Robot, q: Floats, times: list[float]) -> tuple[Posture, ...]:
    rotation, origin = link_frames(robot, q)
    found = []
    for k, t in enumerate(times):

        def placed(link: int, point: Vector, k: int = k) -> Vector:
            x, y, z = (rotation[k, link] @ np.array(point) + origin[k, link]).tolist()
            return (x, y, z)

        parts = tuple(
            Part(c.name, c.link, placed(c.link, c.a_m), placed(c.link, c.b_m), c.radius_m) for c in robot.capsules
        )
        found.append(Posture(t, tuple(q[k].tolist()), parts, placed(len(robot.model.joints), robot.tool.tcp_m)))
    return tuple(found)


def nearest(part: Part, shape: Shape) -> Nearest:
    """Where the two surfaces are nearest."""
    a, b = np.array([part.a_m]), np.array([part.b_m])
    match shape:
        case Capsule(c, d, radius):
            on_axis, on_core = segment_segment(a, b, np.array([c]), np.array([d]))
        case Sphere(center, radius):
            on_axis, on_core = segment_segment(a, b, np.array([center]), np.array([center]))
        case Box(center, half, quaternion):
            radius = 0.0
            on_axis, on_core = segment_box(a, b, np.array([center]), rotation_of(quaternion)[None], np.array([half]))
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

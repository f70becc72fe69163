"""Pairs of a question in their one order, and the bounds proven for a pair on an interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.pit.checker.arm import lowest
from pep.pit.checker.distances import (
    CheckerBox,
    Face,
    Polytope,
    Segment,
    between_segments,
    dot,
    from_block,
    from_polytope,
    length,
    reach,
)
from pep.pit.checker.question import VIOLABLE, Obstacle
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.arm import CheckerRoute, Pose
    from pep.pit.checker.distances import Vec
    from pep.pit.checker.question import Cell
    from pep.pit.checker.robot import CheckerBody, CheckerRobot

PAIRS_MOST: Final = 200_000  # of one question; bounds the work
ROUNDING_M: Final = 1e-9  # far above float64 rounding of metre-sized sums, far below anything that matters
APART_M: Final = 1e-9  # cores nearer than this give no direction
AXIS_MET_M: Final = 1e-3  # PHY-6: a body's axis this near to a thing's surface has met it


@dataclass(frozen=True, slots=True)
class Pair:
    """A body and one obstacle of it.

    Attributes:
        violated_below: clearance (metre) below which the pair is a violation; None where it cannot be.
        touchable: the contact is declared and granted.
    """

    body: CheckerBody
    obstacle: Obstacle
    violated_below: float | None
    touchable: bool


def pairs_of(robot: CheckerRobot, obstacles: Sequence[Obstacle], cell: Cell) -> list[Pair]:
    """Every pair, from the robot and the scene alone, so that none can be left out.

    Order: each obstacle with each moving capsule; what must stay apart on the arm itself; each face of the workspace
    with each moving capsule.
    """
    need(len(robot.moving) * len(obstacles) <= PAIRS_MOST, Code.TOO_LARGE, "scene")

    def against(each: Obstacle) -> list[Pair]:
        return [
            Pair(body, each, _violated_below(body, each, cell), body.part in each.touched_by) for body in robot.moving
        ]

    own = [
        Pair(
            body,
            Obstacle("self", "", Segment(fixed.a, fixed.b), fixed.radius, 0.0, cell.rigid_band_m),
            -cell.overlap_limit_m,
            touchable=False,
        )
        for body, fixed in robot.apart
    ]
    world = [pair for each in obstacles if each.kind != "workspace" for pair in against(each)]
    return world + own + [pair for each in obstacles if each.kind == "workspace" for pair in against(each)]


def _violated_below(body: CheckerBody, obstacle: Obstacle, cell: Cell) -> float | None:
    """PHY-5, PHY-6: clearance below which a body and what is around the arm are a violation, metre."""
    if obstacle.kind in {"fragile", "rigid"}:
        met = max(body.radius - AXIS_MET_M, 0.0)
        return max(-cell.overlap_limit_m, -(met if body.overhang is None else min(body.overhang, met)))
    return 0.0 if obstacle.kind in VIOLABLE else None


def _gap(pose: Pose, core: Segment | CheckerBox | Polytope) -> Vec:
    match core:
        case Segment(a, b):
            return between_segments(pose[0], pose[1], a, b)
        case CheckerBox():
            return from_block(pose[0], pose[1], core)
        case Polytope():
            return from_polytope(pose[0], pose[1], core)


def _behind(pose: Pose, face: Face) -> float:
    return face.offset - max(dot(pose[0], face.normal), dot(pose[1], face.normal))


def attained(way: CheckerRoute, pair: Pair, node: int) -> float:
    """The signed clearance at one configuration: core distance less both radii, metre."""
    pose, core = way.pose(pair.body, node), pair.obstacle.core
    apart = _behind(pose, core) if isinstance(core, Face) else length(_gap(pose, core))
    return apart - pair.body.radius - pair.obstacle.radius


def met_at(way: CheckerRoute, pair: Pair, low: int, high: int) -> float:
    """Signed clearance in the middle of the interval, or beside it within the stray, metre."""
    stray = way.stray(pair.body, low, high)
    near = attained(way, pair, (low + high) // 2) - stray
    touching = -pair.body.radius - pair.obstacle.radius
    return near if isinstance(pair.obstacle.core, Face) else max(near, touching)


def clearance(way: CheckerRoute, pair: Pair, low: int, high: int) -> float:
    """Clearance that holds on the whole interval (PHY-9), metre.

    Along a fixed direction the axis stays within the sag of what it reaches at the ends and the middle; the direction
    is that of the shortest way at the middle.
    """
    body, core = pair.body, pair.obstacle.core
    poses = (way.pose(body, low), way.pose(body, (low + high) // 2), way.pose(body, high))
    radii = body.radius + pair.obstacle.radius
    taken = radii + way.sag(body, low, high) + ROUNDING_M
    if isinstance(core, Face):
        return min(_behind(pose, core) for pose in poses) - taken
    x, y, z = gap = _gap(poses[1], core)
    apart = length(gap)
    if not apart > APART_M:
        return -radii
    direction: Vec = (x / apart, y / apart, z / apart)
    return max(lowest(poses, direction) - reach(core, direction) - taken, -radii)

"""Questions of the benchmark: moves of every joint among things of three shapes, lines, sequences, stream steps."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from evaluation.pit.question import Question
from evaluation.pit.ruler import Ruler
from evaluation.pit.sampled import pose_of
from pep.pit import (
    Box,
    Capsule,
    CellParameters,
    JointLeg,
    JointPath,
    MoveJ,
    MoveL,
    Robot,
    Scene,
    ServoJ,
    SpeedJ,
    Sphere,
    Thing,
    adult_at_distance,
)
from pep.pit.assessment.dispatch import drive_of
from pep.pit.base.errors import UnprovenError
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.engine import chosen
from pep.pit.search.speed_envelope import stream_envelope
from pep.pit.search.timed_course import TimedCourse

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator

    from pep.pit import Motion
    from pep.pit.base.motion import Joints, Pose
    from pep.pit.path.course import Course
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Shape, Vector

AGE_S: Final = 0.1
"""Age of the view, in every question."""
TIME_LIMIT_S: Final = 60.0
"""A slow engine is slow here, and no fault."""
WAY_RAD, SPEED_RAD_S, ACCELERATION_RAD_S2 = 2.0, 1.05, 1.4
"""Way of every joint; speed and acceleration are the controller's defaults."""
NEAR_M, FAR_M, MIDDLE_M = 0.25, 0.75, 0.15
"""Things stand so far about the point so high over the base."""
ROOM_M: Final = 0.005
"""Least distance of a thing to the way: a sampled distance says nothing of bodies that overlap."""
LEGS: Final = 20
LINE_M: Final = (0.1, 0.2)
"""Length of a line."""
PROVEN_SHARE: Final = 0.75
"""Share of a joint's greatest speed up to which the speed adds nothing to the index."""
HOME: Final = (0.0, -1.62, 1.25, -1.20, -1.57, 0.0)
PEOPLE_M: Final = (0.9, 1.2)


@cache
def robot() -> Robot:
    """The arm of every question."""
    return Robot.load("ur3e")


@cache
def cell() -> CellParameters:
    """The parameters of every question; all that stands in the cell is in the scene."""
    return CellParameters(objects=(), time_limit_s=TIME_LIMIT_S)


def moves(rng: Generator, count: int) -> list[MoveJ]:
    """Moves of 2 rad on all six joints on which the arm keeps clear of itself."""
    found: list[MoveJ] = []
    while len(found) < count:
        start = np.array(HOME) + rng.uniform(-1.2, 1.2, 6)
        target = start + WAY_RAD * rng.choice([-1, 1], 6)
        if np.abs([start, target])[:, 2].max() > math.pi:
            continue
        move = MoveJ(joints(start), joints(target), SPEED_RAD_S, ACCELERATION_RAD_S2)
        pairs = pairs_of(robot(), Scene(), cell(), grown_m=0.0)
        if Ruler(chosen(), robot(), cell(), pairs, np.arange(len(pairs))).least(move).proven > ROOM_M:
            found.append(move)
    return found


def around(rng: Generator, move: MoveJ, count: int) -> Scene:
    """Balls, capsules and boxes in equal parts about the arm, none of them on the way of the move."""
    rows = np.arange(robot().world_bodies)
    return _clear(rng, count, lambda pairs: Ruler(chosen(), robot(), cell(), pairs, rows).least(move).proven)


def beside(rng: Generator, course: Course, count: int) -> Scene:
    """Scene of things beside the course, none of them on its way."""
    cells, bodies = course.cells, robot().world_bodies
    low, high, rows = (
        np.repeat(cells.low, bodies),
        np.repeat(cells.high, bodies),
        np.tile(np.arange(bodies), len(cells)),
    )
    return _clear(rng, count, lambda pairs: float(course.examine(pairs, low, high, rows).clear_m.min()))


def _clear(rng: Generator, count: int, least: Callable[[Pairs], float]) -> Scene:
    """Things to which `least`, which is asked of each one's pairs with the moving bodies, is more than `ROOM_M`."""
    things: list[Thing] = []
    while len(things) < count:
        thing = Thing(f"thing{len(things)}", "rigid", _shape(rng, len(things) % 3), cell().object_uncertainty_m)
        if least(pairs_of(robot(), Scene(objects=(thing,)), cell(), grown_m=0.0)) > ROOM_M:
            things.append(thing)
    return Scene(objects=tuple(things))


def with_people(scene: Scene) -> Scene:
    """The scene and two standing adults."""
    people = tuple(adult_at_distance(far, bearing_rad=2.5 * k, name=f"person{k}") for k, far in enumerate(PEOPLE_M))
    return replace(scene, people=people)


def bare(rng: Generator, things: int, count: int) -> list[Question]:
    """Moves among things alone, for which a sampled distance exists as well."""
    return [Question(robot(), around(rng, move, things), move, cell()) for move in moves(rng, count)]


def peopled(rng: Generator, things: int, count: int) -> list[Question]:
    """Moves among things and two people."""
    return [replace(each, scene=with_people(each.scene)) for each in bare(rng, things, count)]


def lines(rng: Generator, things: int, count: int) -> list[Question]:
    """Lines of the tool of 0.1 m to 0.2 m from about the home position, among things and two people.

    They are what a cell asks for: proven to their end, no joint faster than it may be.
    """
    found: list[Question] = []
    while len(found) < count:
        start = np.array(HOME) + rng.uniform(-0.3, 0.3, 6)
        x, y, z, *turn = pose_of(robot(), joints(start))
        way = rng.standard_normal(3)
        way *= rng.uniform(*LINE_M) / np.linalg.norm(way)
        target = cast("Pose", (x + way[0], y + way[1], z + way[2], *turn))
        move = MoveL(joints(start), target, 0.25, 1.2)
        drive = _proven(move)
        if drive is None or z + way[2] < _LOW_M:
            continue
        found.append(Question(robot(), with_people(beside(rng, drive.course, things)), move, cell()))
    return found


def _proven(move: MoveL) -> TimedCourse | None:
    """The line where it is proven to its end, and no joint's speed alone is more than it may be."""
    try:
        drive = drive_of(robot(), move, cell(), perception_age_s=AGE_S, check_time=lambda: None)
    except UnprovenError:
        return None
    if not isinstance(drive, TimedCourse):
        return None
    fastest = drive.joint_speeds_rad_s(drive.profile).max(axis=0) / robot().speed_limits_rad_s
    return drive if float(fastest.max()) <= PROVEN_SHARE else None


def sequences(rng: Generator, things: int, count: int) -> list[Question]:
    """Twenty joint moves in one path, among things and two people."""
    found: list[Question] = []
    for _ in range(count):
        at = np.array(HOME)
        ends = [at + rng.uniform(-0.4, 0.4, 6) for _ in range(LEGS)]
        legs = tuple(JointLeg(joints(end), SPEED_RAD_S, ACCELERATION_RAD_S2) for end in ends)
        whole = MoveJ(HOME, joints(ends[0]), SPEED_RAD_S, ACCELERATION_RAD_S2)
        found.append(Question(robot(), with_people(around(rng, whole, things)), JointPath(HOME, legs), cell()))
    return found


def steps(rng: Generator, things: int, count: int, *, servo: bool) -> list[Question]:
    """Steps of a stream under way: all that one target, or set of joint speeds, allows until standstill."""
    found: list[Question] = []
    for _ in range(count):
        start, qd = np.array(HOME) + rng.uniform(-0.3, 0.3, 6), rng.uniform(-0.3, 0.3, 6)
        step: ServoJ | SpeedJ
        motion: Motion
        if servo:
            step = motion = ServoJ(joints(start), joints(qd), joints(start + 0.1 * qd), 0.002, 0.1)
        else:
            step = SpeedJ(joints(start), joints(qd), 2.0, 0.1)
            motion = stream_envelope(step, cell(), under_way=True)
        still = MoveJ(joints(start), joints(start + 1e-3), SPEED_RAD_S, ACCELERATION_RAD_S2)
        found.append(Question(robot(), with_people(around(rng, still, things)), motion, cell(), step))
    return found


_LOW_M: Final = 0.1


def joints(angles: object) -> Joints:
    """Six angles, or speeds, of any array."""
    a, b, c, d, e, f = np.asarray(angles, dtype=float).tolist()
    return a, b, c, d, e, f


def _shape(rng: Generator, kind: int) -> Shape:
    direction = rng.standard_normal(3)
    center = direction / np.linalg.norm(direction) * rng.uniform(NEAR_M, FAR_M) + np.array([0.0, 0.0, MIDDLE_M])
    if kind == 0:
        return Sphere(_point(center), float(rng.uniform(0.02, 0.06)))
    if kind == 1:
        half = rng.standard_normal(3)
        half *= rng.uniform(0.03, 0.12) / np.linalg.norm(half)
        return Capsule(_point(center - half), _point(center + half), float(rng.uniform(0.015, 0.05)))
    turn = rng.standard_normal(4)
    w, x, y, z = (turn / np.linalg.norm(turn)).tolist()
    return Box(_point(center), _point(rng.uniform(0.02, 0.07, 3)), (w, x, y, z))


def _point(place: object) -> Vector:
    x, y, z = np.asarray(place, dtype=float).tolist()
    return x, y, z

"""Arithmetic of the second engine, on the links' frames of pinocchio and the core distances of coal.

It takes pinocchio's frames and Jacobians. Of the searches it takes the law of an index, by which it settles pairs
without a measured distance; no other error of the searches can enter here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import pinocchio

from pep.pit.base.pair_columns import BAND, BODY, INTRUSION, KIND, PERSON, UNCERTAINTY, VIOLATED_BELOW
from pep.pit.base.tier import MOVING
from pep.pit.robot.robot import Robot
from pep.pit.scene.cell import CellParameters
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import VIOLATION_RESOLUTION_M
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry, lent
from pep.pit.search.kernel.arithmetic.index_law import pair_index
from pep.pit.search.kernel.compiled_path import field_of, law_of
from pep.pit.second.second_engine import DISTANCE_TOLERANCE_M, INDEX_TOLERANCE, SecondWorld

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping

    Whole = NDArray[np.int64]

# Columns of each of a robot's bodies: both ends in the frame of the link, radius, half the axis.
ENDS, RADIUS, HALF = 0, 6, 7
LINK, REFERENCE = 0, 1
# Of the robot's own pairs: the middle and half the axis of the capsule that a body must mind, radii together.
OWN_CENTER, OWN_HALF, OWN_RADII = 0, 3, 4
OWN_LINK, OWN_BODY = 0, 1
# Of a thing: centre and radius of the ball around its core, and the radius that the core leaves out.
BALL, AROUND, LEFT_OUT = 0, 3, 4
# How the motion ends: what a person keeps clear of an arm at rest, and travel by speed towards people and towards
# what is known; then what two libraries may differ by, and what is a touch and no violation, metre.
STANDS_OFF, PER_SPEED, KNOWN_PER_SPEED, GRANTED, GRAZES = range(5)
AXES: Final = 3


@lent
def _norm(x: float, y: float, z: float) -> float:
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _moved(
    turns: Floats, origins: Floats, jacobian: Floats, rates: Floats, numbers: Floats, whole: Whole, out: Floats
) -> Floats:
    """Writes the surface speed of every body relative to its reference link to `out`, (bodies,).

    It returns both ends, (bodies, 2, 3).

    Pinocchio's Jacobian has a column per joint: the speed of what is at the base's origin, and the turning, that it
    gives all links behind it.
    """
    joints, bodies = rates.shape[0], whole.shape[0]
    ends, twist = np.empty((bodies, 2, 3)), np.zeros((joints + 1, 6))
    for joint in range(joints):
        for i in range(6):
            twist[joint + 1, i] = twist[joint, i] + jacobian[i, joint] * rates[joint]
    for body in range(bodies):
        link, reference, fastest = whole[body, LINK], whole[body, REFERENCE], 0.0
        vx, vy = twist[link, 0] - twist[reference, 0], twist[link, 1] - twist[reference, 1]
        vz, wx = twist[link, 2] - twist[reference, 2], twist[link, 3] - twist[reference, 3]
        wy, wz = twist[link, 4] - twist[reference, 4], twist[link, 5] - twist[reference, 5]
        for end in range(2):
            at = ENDS + 3 * end
            for i in range(3):
                ends[body, end, i] = origins[link, i] + (
                    turns[link, i, 0] * numbers[body, at]
                    + turns[link, i, 1] * numbers[body, at + 1]
                    + turns[link, i, 2] * numbers[body, at + 2]
                )
            x, y, z = ends[body, end, 0], ends[body, end, 1], ends[body, end, 2]
            fastest = max(fastest, _norm(wy * z - wz * y + vx, wz * x - wx * z + vy, wx * y - wy * x + vz))
        out[body] = fastest + numbers[body, RADIUS] * _norm(wx, wy, wz)
    return ends


@lent
def _balls(
    turns: Floats,
    origins: Floats,
    ends: Floats,
    numbers: Floats,
    things: Floats,
    own: Floats,
    own_whole: Whole,
    moving: int,
    near: Floats,
) -> None:
    """Writes to `near` the clearance of the balls around all bodies' and things' cores, a bound of their own."""
    for body in range(moving):
        x = 0.5 * (ends[body, 0, 0] + ends[body, 1, 0])
        y = 0.5 * (ends[body, 0, 1] + ends[body, 1, 1])
        z = 0.5 * (ends[body, 0, 2] + ends[body, 1, 2])
        reach = numbers[body, HALF] + numbers[body, RADIUS]
        for thing in range(things.shape[0]):
            apart = _norm(x - things[thing, BALL], y - things[thing, BALL + 1], z - things[thing, BALL + 2])
            near[thing * moving + body] = apart - reach - things[thing, AROUND] - things[thing, LEFT_OUT]
    first = things.shape[0] * moving
    for k in range(own.shape[0]):
        link, body = own_whole[k, OWN_LINK], own_whole[k, OWN_BODY]
        a, b, c = own[k, OWN_CENTER], own[k, OWN_CENTER + 1], own[k, OWN_CENTER + 2]
        x = origins[link, 0] + turns[link, 0, 0] * a + turns[link, 0, 1] * b + turns[link, 0, 2] * c
        y = origins[link, 1] + turns[link, 1, 0] * a + turns[link, 1, 1] * b + turns[link, 1, 2] * c
        z = origins[link, 2] + turns[link, 2, 0] * a + turns[link, 2, 1] * b + turns[link, 2, 2] * c
        apart = _norm(
            x - 0.5 * (ends[body, 0, 0] + ends[body, 1, 0]),
            y - 0.5 * (ends[body, 0, 1] + ends[body, 1, 1]),
            z - 0.5 * (ends[body, 0, 2] + ends[body, 1, 2]),
        )
        near[first + k] = apart - own[k, OWN_HALF] - numbers[body, HALF] - own[k, OWN_RADII]


@lent
def _faces(ends: Floats, numbers: Floats, room: Floats, moving: int, first: int, near: Floats) -> None:
    """Writes to `near` from `first` on the clearance from each face of the room, highest and lowest of each axis."""
    for axis in range(AXES):
        for body in range(moving):
            a, b, radius = ends[body, 0, axis], ends[body, 1, axis], numbers[body, RADIUS]
            near[first + 2 * axis * moving + body] = room[1, axis] - max(a, b) - radius
            near[first + (2 * axis + 1) * moving + body] = min(a, b) - room[0, axis] - radius


@entry
def confirmed(
    turns: Floats,
    origins: Floats,
    jacobians: Floats,
    rates: Floats,
    numbers: Floats,
    whole: Whole,
    own: Floats,
    own_whole: Whole,
    things: Floats,
    room: Floats,
    measured: Floats,
    kernel: Floats,
    pair_numbers: Floats,
    pair_whole: Whole,
    stop: Floats,
    law: Floats,
    moving: int,
    since: int,
    upper: float,
) -> tuple[Floats, Floats, bool, Whole]:
    """Clearances and speeds of all pairs at some places, with the pairs that stay open.

    Args:
        turns, origins: pinocchio's frames, (places, links, 3, 3) and (places, links, 3).
        jacobians: pinocchio's, (places, 6, joints).
        rates: of the joints, (places, joints), rad/s.
        numbers, whole: of each body (`ENDS` and so on; `LINK`, `REFERENCE`).
        own, own_whole: of each of the arm's own pairs (`OWN_CENTER` and so on; `OWN_LINK`, `OWN_BODY`).
        things: of each thing (`BALL` and so on).
        room: lowest and highest corner, or no rows.
        measured: coal's distances of cores at the first places, (measured, pairs of bodies).
        kernel: the first engine's clearances there, (measured, pairs).
        pair_numbers, pair_whole: the pairs' laws, kinds and bodies (`rows.Field`), and of it nothing else.
        stop: the motion's end, and the granted limits (`STANDS_OFF` and so on).
        law: its end, and the common bands (`columns.REACTION` and so on).
        moving: number of bodies that move in the world; they stand first.
        since: the first place of which open pairs count.
        upper: the index that a pair without measured distance may not exceed.

    Returns:
        As the last four of `pep.pit.second.second_engine.Sight`.
    """
    places, pairs, of_things = turns.shape[0], kernel.shape[1], things.shape[0] * moving
    of_bodies, bodies = of_things + own.shape[0], whole.shape[0]
    near, speed, agrees = np.empty((places, pairs)), np.empty((places, bodies)), True
    doubts, used = np.empty((places * pairs, 2), np.int64), 0
    for place in range(places):
        row, speeds = near[place], speed[place]
        ends = _moved(turns[place], origins[place], jacobians[place], rates[place], numbers, whole, speeds)
        if place < measured.shape[0]:
            for pair in range(of_bodies):
                row[pair] = max(measured[place, pair], 0.0)
            for thing in range(things.shape[0]):
                for body in range(moving):
                    row[thing * moving + body] -= things[thing, LEFT_OUT] + numbers[body, RADIUS]
            for k in range(own.shape[0]):
                row[of_things + k] -= own[k, OWN_RADII]
        else:
            _balls(turns[place], origins[place], ends, numbers, things, own, own_whole, moving, row)
        if room.shape[0] > 0:
            _faces(ends, numbers, room, moving, of_bodies, row)
        if place < measured.shape[0]:
            for pair in range(pairs):
                agrees = agrees and abs(row[pair] - kernel[place, pair]) <= stop[GRANTED]
        if place < since:
            continue
        for pair in range(pairs):
            gap, fast = row[pair] + stop[GRANTED], speeds[pair_whole[pair, BODY]]
            calm = stop[KNOWN_PER_SPEED] * fast + pair_numbers[pair, BAND]
            if pair_whole[pair, KIND] == PERSON:
                calm = stop[PER_SPEED] * fast + pair_numbers[pair, INTRUSION] + stop[STANDS_OFF]
            settled = gap - pair_numbers[pair, UNCERTAINTY] >= calm
            if not settled and place >= measured.shape[0]:
                settled = pair_index(pair_whole[pair, KIND], pair_numbers, pair, gap, fast, law) <= upper
            if not settled or gap + stop[GRAZES] < pair_numbers[pair, VIOLATED_BELOW]:
                doubts[used, 0], doubts[used, 1] = place, pair
                used += 1
    return near, speed, agrees, doubts[:used].copy()


def sight(
    world: SecondWorld, q: Floats, qd: Floats, kernel: Floats, *, stop: Stopping, since: int, upper: float
) -> tuple[Floats, Floats, bool, Whole]:
    """Sight as of `pep.pit.second.straight_check.look`: the last four of its members."""
    model, stage, pairs = world.robot.pinocchio, world.stage, world.pairs
    count, links = len(q), len(stage.turns)
    turns, origins = np.empty((count, links, AXES, AXES)), np.empty((count, links, AXES))
    jacobians, measured = np.empty((count, 6, links - 1)), np.empty((len(kernel), len(world.radius)))
    for k, angles in enumerate(q):
        jacobians[k] = pinocchio.computeJointJacobians(model, stage.kinematics, angles)
        turns[k], origins[k] = stage.turns, stage.origins
        if k < len(kernel):
            measured[k] = world.distances(angles)
    workspace = world.scene.workspace
    room = np.zeros((0, AXES)) if workspace is None else np.array([workspace.low_m, workspace.high_m])
    stands_off = float(stop.approach_m(np.zeros(()))) + pairs.warn_band
    per_speed = stop.reaction_s + stop.travel_s
    ends = np.array([stands_off, per_speed, stop.travel_s, DISTANCE_TOLERANCE_M, VIOLATION_RESOLUTION_M])
    _, numbers, whole = field_of(pairs)
    return confirmed(
        turns,
        origins,
        jacobians,
        qd,
        *stage.blocks,
        world.balls,
        room,
        measured,
        kernel,
        numbers,
        whole,
        ends,
        np.array(law_of(pairs, stop)),
        world.robot.world_bodies,
        since,
        upper + INDEX_TOLERANCE,
    )


def compile_all() -> None:
    """Compiles every entry, or reads it from disk."""
    robot, cell = Robot.load("ur3e"), CellParameters()
    scene, still = cell.surveyed, np.zeros((1, len(robot.model.joints)))
    pairs = pairs_of(robot, scene, cell, grown_m=0.0)
    stop = stopping(cell, perception_age_s=0.0, joint_speed_rad_s=0.0)
    sight(SecondWorld(robot, scene, pairs), still, still, np.zeros((1, len(pairs))), stop=stop, since=0, upper=MOVING)

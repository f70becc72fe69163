"""Rows of (interval, pair) with their proven bounds, and the loops that fill them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import (
    APART,
    AROUND,
    BALL,
    BALL_BODY,
    BALL_NUMBERS,
    BALL_PERSON,
    BAND,
    BODY,
    CALM,
    CENTER,
    INTRUSION,
    KIND,
    PERSON,
    PLANE,
    RADII,
    SHAPE,
    UNCERTAINTY,
    VIOLATED_BELOW,
)
from pep.pit.geometry.clearance import ROUNDING_M
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.kernel.arithmetic.body_poses import more_nodes, place, pose
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.core_distance import core_gap, interval_gap
from pep.pit.search.kernel.arithmetic.row_table import (
    BOUND,
    CLEAR,
    CLEAR_MID,
    HIGH,
    LOW,
    PAIR,
    RUSH,
    RUSH_MID,
    room_for,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm, Bends, Nodes
    from pep.pit.search.kernel.arithmetic.row_table import Rows

    Whole = NDArray[np.int64]


class StraightPath(NamedTuple):
    """Straight joint path of one arm: start and target, rad, and its bodies' bends."""

    arm: Arm
    start: Floats
    delta: Floats
    bends: Bends


class Field(NamedTuple):
    """The pairs, a row each, with columns as `pep.pit.base.pair_columns` names them.

    Attributes:
        balls: numbers of every pair for every span of the first cut.
        numbers, whole: numbers of near pairs; behind the pairs' numbers stand the rows of polytopes.
    """

    balls: Floats
    numbers: Floats
    whole: Whole


@compiled
def configuration(nodes: Nodes, used: int, way: StraightPath, key: int) -> Nodes:
    """The nodes with the configuration at `key` in row `used`."""
    if used >= nodes.speed.shape[0]:
        nodes = more_nodes(nodes)
    q = np.empty(way.start.shape[0])
    for joint in range(q.shape[0]):
        q[joint] = way.start[joint] + key / GRID * way.delta[joint]
    pose(nodes, used, way.arm, q, way.delta)
    return nodes


@entry
def balls_of(numbers: Floats, whole: Whole, warn_band: float) -> Floats:
    """`Field.balls` of these rows, (pairs, `BALL_NUMBERS`); the column `CALM` of `numbers` is written, too."""
    balls = np.empty((whole.shape[0], BALL_NUMBERS))
    for pair in range(whole.shape[0]):
        person = whole[pair, KIND] == PERSON
        calm = numbers[pair, INTRUSION] + warn_band if person else numbers[pair, BAND]
        calm += numbers[pair, UNCERTAINTY]
        numbers[pair, CALM] = calm
        for i in range(3):
            balls[pair, BALL + i] = numbers[pair, CENTER + i]
        apart = max(calm, numbers[pair, VIOLATED_BELOW]) + numbers[pair, AROUND] + numbers[pair, RADII]
        balls[pair, APART] = math.inf if whole[pair, SHAPE] == PLANE else apart  # a plane has no centre
        balls[pair, BALL_BODY] = whole[pair, BODY]
        balls[pair, BALL_PERSON] = 1.0 if person else 0.0
    return balls


@lent
def rush_at_most(way: StraightPath, body: int, width: float) -> float:
    """Bound on the body's surface speed per unit of ds/dt on such an interval, without any configuration."""
    bend = width * width / CHORD
    speed = way.bends.first[body] + way.bends.third[body] * bend
    return speed + way.arm.radius[body] * (way.bends.spin[body] + way.bends.spin_second[body] * bend)


@lent
def strays_at_most(way: StraightPath, body: int, width: float) -> float:
    """Distance of any part of the body's axis from its place in the interval's middle, at most, metre.

    Its levers bound the way in half the interval. The sag is added, so that no clearance found from this is above what
    `interval_gap` proves.
    """
    return 0.5 * way.bends.first[body] * width + way.bends.second[body] * width * width / CHORD + 2.0 * ROUNDING_M


@lent
def ball_gap(ends: Floats, at: int, body: int, half: Floats, numbers: Floats, pair: int) -> float:
    """Clearance of the balls around both cores, radii taken off; the body is placed at `at`.

    Not for planes.
    """
    x = 0.5 * (ends[at, body, 0, 0] + ends[at, body, 1, 0]) - numbers[pair, CENTER]
    y = 0.5 * (ends[at, body, 0, 1] + ends[at, body, 1, 1]) - numbers[pair, CENTER + 1]
    z = 0.5 * (ends[at, body, 0, 2] + ends[at, body, 1, 2]) - numbers[pair, CENTER + 2]
    return math.sqrt(x * x + y * y + z * z) - half[body] - numbers[pair, AROUND] - numbers[pair, RADII]


@compiled
def examine(nodes: Nodes, way: StraightPath, field: Field, asked: Whole, stand: Whole) -> Rows:
    """Bounds proven on each row's interval, and values attained in its middle.

    Args:
        nodes: holds the configurations of every interval.
        way, field: the path and all pairs.
        asked: the rows (LOW, HIGH, PAIR), intervals in 1 / GRID.
        stand: rows of each interval's three configurations in `nodes`, (n, 3).
    """
    rows = room_for(asked.shape[0])
    ends, placed, speeds, spins = nodes.ends, nodes.known, nodes.speed, nodes.spin
    numbers, whole, radius = field.numbers, field.whole, way.arm.radius
    second, third, spin_second = way.bends.second, way.bends.third, way.bends.spin_second
    found = rows.numbers
    copy_into(rows.whole, asked)
    for row in range(asked.shape[0]):
        k = asked[row, PAIR]
        body, shape = whole[k, BODY], whole[k, SHAPE]
        first, middle, last = stand[row, 0], stand[row, 1], stand[row, 2]
        for at in (first, middle, last):
            if not placed[at, body]:
                place(nodes, at, way.arm, body)
        width = (asked[row, HIGH] - asked[row, LOW]) / GRID
        bend = width * width / CHORD
        gap = core_gap(ends, middle, body, numbers, k, shape)
        found[row, CLEAR] = interval_gap(ends, first, middle, last, body, numbers, k, shape, gap, second[body] * bend)
        speed = max(speeds[first, body], speeds[middle, body], speeds[last, body]) + third[body] * bend
        spin = max(spins[first, body], spins[middle, body], spins[last, body]) + spin_second[body] * bend
        found[row, RUSH] = speed + radius[body] * spin
        found[row, CLEAR_MID] = gap[0] - numbers[k, RADII]
        found[row, RUSH_MID] = speeds[middle, body] + radius[body] * spins[middle, body]
        found[row, BOUND] = 0.0
    return rows


@compiled
def meets(nodes: Nodes, at: int, way: StraightPath, field: Field, pair: Whole) -> tuple[Floats, Floats]:
    """Signed clearance and surface speed per unit of ds/dt of each of these pairs at one configuration."""
    count = pair.shape[0]
    clearance, rush = np.empty(count), np.empty(count)
    ends, placed, speeds, spins = nodes.ends, nodes.known, nodes.speed, nodes.spin
    numbers, whole, radius = field.numbers, field.whole, way.arm.radius
    for row in range(count):
        k = pair[row]
        body = whole[k, BODY]
        if not placed[at, body]:
            place(nodes, at, way.arm, body)
        clearance[row] = core_gap(ends, at, body, numbers, k, whole[k, SHAPE])[0] - numbers[k, RADII]
        rush[row] = speeds[at, body] + radius[body] * spins[at, body]
    return clearance, rush

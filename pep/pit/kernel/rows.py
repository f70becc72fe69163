"""Rows of (interval, pair) and what is proven there; the loops that fill them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pep.pit.clearance import ROUNDING_M
from pep.pit.kernel.arm import more_nodes, place, pose
from pep.pit.kernel.columns import AROUND, BODY, CENTER, RADII, SHAPE
from pep.pit.kernel.compiled import compiled
from pep.pit.kernel.gap import KNOTS, core_gap, interval_gap
from pep.pit.path import CHORD, GRID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Arm, Bends, Nodes
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]


class Way(NamedTuple):
    """A straight joint path of one arm: where it starts and where to, rad, and how strongly its bodies bend."""

    arm: Arm
    start: Floats
    delta: Floats
    bends: Bends


class Field(NamedTuple):
    """The pairs: their numbers and their whole numbers, with columns as `pep.pit.kernel.columns` names them."""

    numbers: Floats
    whole: Whole


class Rows(NamedTuple):
    """Rows as `pep.pit.path.Leaves` has them, and the index proven on each."""

    low: Whole
    high: Whole
    pair: Whole
    clear: Floats
    rush: Floats
    clear_mid: Floats
    rush_mid: Floats
    bound: Floats


@compiled
def no_rows(count: int) -> Rows:
    """Room for so many rows."""
    return Rows(
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count),
    )


@compiled
def more_rows(rows: Rows, used: int, count: int) -> Rows:
    """The first `used` rows, with room for at least so many more."""
    wide = no_rows(used + max(used, count))
    wide.low[:used] = rows.low[:used]
    wide.high[:used] = rows.high[:used]
    wide.pair[:used] = rows.pair[:used]
    wide.clear[:used] = rows.clear[:used]
    wide.rush[:used] = rows.rush[:used]
    wide.clear_mid[:used] = rows.clear_mid[:used]
    wide.rush_mid[:used] = rows.rush_mid[:used]
    wide.bound[:used] = rows.bound[:used]
    return wide


@compiled
def taken(rows: Rows, used: int) -> Rows:
    """The first `used` rows alone."""
    return Rows(
        rows.low[:used].copy(),
        rows.high[:used].copy(),
        rows.pair[:used].copy(),
        rows.clear[:used].copy(),
        rows.rush[:used].copy(),
        rows.clear_mid[:used].copy(),
        rows.rush_mid[:used].copy(),
        rows.bound[:used].copy(),
    )


@compiled
def configuration(nodes: Nodes, used: int, way: Way, key: int) -> Nodes:
    """The nodes with the configuration at `key` in row `used`."""
    if used >= nodes.speed.shape[0]:
        nodes = more_nodes(nodes)
    s = key / GRID
    q = np.empty(6)
    for joint in range(6):
        q[joint] = way.start[joint] + s * way.delta[joint]
    pose(nodes, used, way.arm, q, way.delta)
    return nodes


@compiled
def rush_between(nodes: Nodes, low: int, mid: int, high: int, way: Way, body: int, width: float) -> float:
    """Bound on the body's surface speed per unit of ds/dt on an interval of that width; it is placed at all three."""
    bend = width * width / CHORD
    speed = max(nodes.speed[low, body], nodes.speed[mid, body], nodes.speed[high, body])
    spin = max(nodes.spin[low, body], nodes.spin[mid, body], nodes.spin[high, body])
    speed += way.bends.third[body] * bend
    return speed + way.arm.radius[body] * (spin + way.bends.spin_second[body] * bend)


@compiled
def rush_at_most(way: Way, body: int, width: float) -> float:
    """A bound on `rush_between` that needs no configuration."""
    bend = width * width / CHORD
    speed = way.bends.first[body] + way.bends.third[body] * bend
    return speed + way.arm.radius[body] * (way.bends.spin[body] + way.bends.spin_second[body] * bend)


@compiled
def strays_at_most(way: Way, body: int, width: float) -> float:
    """How far any part of the body's axis is from where it is in the middle of an interval of that width, metre.

    Its levers bound the way in half the interval. The sag is added, so that no clearance found from this is above what
    `interval_gap` proves.
    """
    return 0.5 * way.bends.first[body] * width + way.bends.second[body] * width * width / CHORD + 2.0 * ROUNDING_M


@compiled
def ball_gap(ends: Floats, at: int, body: int, half: Floats, numbers: Floats, pair: int) -> float:
    """Clearance of the balls around both cores, radii taken off; the body is placed at `at`. Nothing for planes."""
    x = 0.5 * (ends[at, body, 0, 0] + ends[at, body, 1, 0]) - numbers[pair, CENTER]
    y = 0.5 * (ends[at, body, 0, 1] + ends[at, body, 1, 1]) - numbers[pair, CENTER + 1]
    z = 0.5 * (ends[at, body, 0, 2] + ends[at, body, 1, 2]) - numbers[pair, CENTER + 2]
    return math.sqrt(x * x + y * y + z * z) - half[body] - numbers[pair, AROUND] - numbers[pair, RADII]


@compiled
def examine(
    nodes: Nodes,
    way: Way,
    field: Field,
    low: Whole,
    high: Whole,
    at_low: Whole,
    at_mid: Whole,
    at_high: Whole,
    pair: Whole,
) -> Rows:
    """What is proven on each row's interval and attained in its middle.

    Args:
        nodes: holds the configurations of every interval.
        way, field: the path and all pairs.
        low, high: intervals, in 1 / GRID; at_low, at_mid, at_high: where their configurations stand in `nodes`.
        pair: of each row.
    """
    count = pair.shape[0]
    rows, knots = no_rows(count), np.empty(KNOTS)
    for row in range(count):
        k = pair[row]
        body = field.whole[k, BODY]
        first, middle, last = at_low[row], at_mid[row], at_high[row]
        place(nodes, first, way.arm, body)
        place(nodes, middle, way.arm, body)
        place(nodes, last, way.arm, body)
        width = (high[row] - low[row]) / GRID
        gap = core_gap(nodes.ends, middle, body, field.numbers, k, field.whole[k, SHAPE], knots)
        sag = way.bends.second[body] * width * width / CHORD
        rows.low[row], rows.high[row], rows.pair[row], rows.bound[row] = low[row], high[row], k, 0.0
        rows.clear[row] = interval_gap(
            nodes.ends, first, middle, last, body, field.numbers, k, field.whole[k, SHAPE], gap, sag
        )
        rows.rush[row] = rush_between(nodes, first, middle, last, way, body, width)
        rows.clear_mid[row] = gap[0] - field.numbers[k, RADII]
        rows.rush_mid[row] = nodes.speed[middle, body] + way.arm.radius[body] * nodes.spin[middle, body]
    return rows


@compiled
def meets(nodes: Nodes, at: int, way: Way, field: Field, pair: Whole) -> tuple[Floats, Floats]:
    """Signed clearance and surface speed per unit of ds/dt of each of these pairs at one configuration."""
    count = pair.shape[0]
    clearance, rush, knots = np.empty(count), np.empty(count), np.empty(KNOTS)
    for row in range(count):
        k = pair[row]
        body = field.whole[k, BODY]
        place(nodes, at, way.arm, body)
        gap = core_gap(nodes.ends, at, body, field.numbers, k, field.whole[k, SHAPE], knots)
        clearance[row] = gap[0] - field.numbers[k, RADII]
        rush[row] = nodes.speed[at, body] + way.arm.radius[body] * nodes.spin[at, body]
    return clearance, rush

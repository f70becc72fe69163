"""Columns of a search: rows of a pair on a span, met places, and bounds of each body."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.tier import TIE
from pep.pit.geometry.clearance import ROUNDING_M
from pep.pit.path.straight_path import CHORD
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.kernel.arithmetic.compilation import compiled, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm, Bends

    Whole = NDArray[np.int64]

KINDS: Final = 8  # how many kinds of pairs there are
ANSWERED: Final = 0
TOO_MANY: Final = 1
HIDDEN: Final = 2  # a row that could not be followed farther may hide a violation
LOOKS: Final = 3  # at each group that did not have to be looked at
SPARE: Final = 512  # rows beyond the first ones for which there is room at first

# What holds of a body on the whole path: its radius, half its axis' length, and how strongly it bends (`arm.Bends`).
RADIUS: Final = 0
HALF: Final = 1
FIRST: Final = 2
SECOND: Final = 3
THIRD: Final = 4
SPIN: Final = 5
SPIN_FIRST: Final = 6
SPIN_SECOND: Final = 7
TABLE: Final = 8

# Whole numbers of a row: its span, its pair, and its stage.
SPAN_OF: Final = 0
PAIR: Final = 1
STAGE: Final = 2
ROW_WHOLE: Final = 3

# Stages: the balls, the distance in the middle, what all three nodes prove; settled for good; or halved, and no row.
BALLS: Final = 0
MIDDLE: Final = 1
NODES: Final = 2
FINAL: Final = 3
HALVED: Final = 4

STAGES_IN_DOUBT: Final = 3  # a row is in doubt at most once a stage

# Numbers of a row: proven clearance and speed, those in the middle, the index, the direction in the middle.
CLEAR: Final = 0
RUSH: Final = 1
CLEAR_MID: Final = 2
RUSH_MID: Final = 3
BOUND: Final = 4
AWAY: Final = 5  # three columns
STRAYS: Final = 5  # before the direction is known: how far the body strays from the middle
ROW_NUMBERS: Final = 8

# Rows of the table of leaves.
LEAF_LOW: Final = 0
LEAF_HIGH: Final = 1
LEAF_PAIR: Final = 2
LEAF_NUMBERS: Final = 3  # the first five of a row's numbers
LEAF: Final = 8

# Columns of a place that was met, and the mark of none.
MET_INDEX: Final = 0
MET_CLEARANCE: Final = 1
MET_SPEED: Final = 2
MET_KEY: Final = 3
MET_PAIR: Final = 4
MET: Final = 5
NOBODY: Final = -1.0

# What a slower speed is found by: how the arm stops, the lowest speed that is of use, and the commanded one.
DELAY: Final = 0
DECELERATION: Final = 1
SLOWEST: Final = 2
COMMANDED: Final = 3
STOP: Final = 4
LEVEL_LOWEST: Final = 12  # spans of 1 / 4096 of the path: enough for 1 % of the speed


class SearchRows(NamedTuple):
    """Rows, of which the first `used[0]` are in use, and rows with a possible violation, of which `used[1]` are."""

    whole: Whole
    numbers: Floats
    doubts: Whole
    used: Whole


@compiled
def with_room(rows: SearchRows, room: int) -> SearchRows:
    """The same rows with room for so many at least."""
    if rows.whole.shape[0] >= room:
        return rows
    whole, numbers = np.empty((2 * room, ROW_WHOLE), np.int64), np.empty((2 * room, ROW_NUMBERS))
    doubts, count, in_doubt = np.empty(STAGES_IN_DOUBT * 2 * room, np.int64), rows.used[0], rows.used[1]
    copy_into(whole, rows.whole[:count])
    copy_into(numbers, rows.numbers[:count])
    copy_into(doubts, rows.doubts[:in_doubt])
    return SearchRows(whole, numbers, doubts, rows.used)


class Met(NamedTuple):
    """Places that were met, by group and by kind, and the rows to look at per group."""

    witnesses: Floats
    violated: Floats
    top: Whole


@compiled
def none_met(count: int) -> Floats:
    """Room for so many places, none of which was met."""
    met = np.zeros((count, MET))
    met[:, MET_PAIR] = NOBODY
    return met


@lent
def note(met: Floats, at: int, index: float, clearance: float, speed: float, key: int, pair: int) -> None:
    """Notes the place when it is higher than the noted one, or as high and nearer."""
    if met[at, MET_PAIR] != NOBODY:
        known = met[at, MET_INDEX]
        if index < known or (index == known and clearance >= met[at, MET_CLEARANCE]):
            return
    met[at, MET_INDEX], met[at, MET_CLEARANCE], met[at, MET_SPEED] = index, clearance, speed
    met[at, MET_KEY], met[at, MET_PAIR] = key, pair


@lent
def settled(bound: float, best: float) -> bool:
    """True where a bound cannot raise the answer by more than the resolution, nor its tier."""
    return bound <= best or (bound <= best + RESOLUTION and math.ceil(bound - TIE) <= math.ceil(best - TIE))


@compiled
def table_of(arm: Arm, bends: Bends) -> Floats:
    """Bounds of each body on the whole path, side by side: shape (bodies, TABLE)."""
    table, radius, half = np.empty((arm.link.shape[0], TABLE)), arm.radius, arm.half
    first, second, third = bends.first, bends.second, bends.third
    spin, spin_first, spin_second = bends.spin, bends.spin_first, bends.spin_second
    for body in range(table.shape[0]):
        table[body, RADIUS], table[body, HALF] = radius[body], half[body]
        table[body, FIRST], table[body, SECOND], table[body, THIRD] = first[body], second[body], third[body]
        table[body, SPIN], table[body, SPIN_FIRST] = spin[body], spin_first[body]
        table[body, SPIN_SECOND] = spin_second[body]
    return table


@lent
def rough(speed: float, swerve: float, spin: float, table: Floats, body: int, width: float) -> tuple[float, float]:
    """Bounds of a span of that width from its middle alone, where the body has this speed, swerve and spin.

    The second derivative is no more than its bound on the whole path, nor than its value in the middle and the third's
    part (Taylor).

    Returns:
        Distance of any part of the body's axis from its place in the middle, at most, metre. The sag is added, so that
        no clearance found from this is above what `interval_gap` proves.
        Its surface speed per unit of ds/dt at most, metre; no less than what all three nodes prove.
    """
    reach, bend, first, second = 0.5 * width, width * width / CHORD, table[body, FIRST], table[body, SECOND]
    third = table[body, THIRD]
    # 1/2 and 1/6, 1 and 1/2: Taylor's, of the way and of the speed.
    strays = min(first, speed + min(0.5 * second, 0.5 * swerve + third * reach / 6.0) * reach) * reach
    fastest = min(first, speed + min(second, swerve + 0.5 * third * reach) * reach) + third * bend
    turns = min(table[body, SPIN], spin + table[body, SPIN_FIRST] * reach) + table[body, SPIN_SECOND] * bend
    return strays + second * bend + 2.0 * ROUNDING_M, fastest + table[body, RADIUS] * turns


@compiled
def ranked(met: Floats) -> Floats:
    """Places that were met, highest first; among equals the nearest, then the earliest."""
    some = np.flatnonzero(met[:, MET_PAIR] != NOBODY)
    for last in range(1, some.shape[0]):  # few, and nearly in order
        one, at = some[last], last
        while at > 0 and _before(met, one, some[at - 1]):
            some[at] = some[at - 1]
            at -= 1
        some[at] = one
    return met[some]


@lent
def _before(met: Floats, one: int, other: int) -> bool:
    for column in range(3):
        which = (MET_INDEX, MET_CLEARANCE, MET_KEY)[column]
        mine, theirs = met[one, which], met[other, which]
        if mine != theirs:
            return mine > theirs if column == 0 else mine < theirs
    return False

"""Levels of the search: intervals of one width, what holds on any of them, and what is far apart on the first."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pep.pit.kernel.arm import place_all
from pep.pit.kernel.columns import AROUND, BODY, CENTER, KIND, PLANE, RADII, SHAPE, VIOLATED_BELOW
from pep.pit.kernel.compiled import compiled
from pep.pit.kernel.law import calm_beyond
from pep.pit.kernel.rows import rush_at_most, strays_at_most
from pep.pit.path import GRID
from pep.pit.tier import MOVING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Nodes
    from pep.pit.kernel.rows import Field, Rows, Way
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]


class Level(NamedTuple):
    """Intervals of one width: their ends, their configurations, and each one's pairs as a stretch of `pairs`."""

    low: Whole
    high: Whole
    at_low: Whole
    at_mid: Whole
    at_high: Whole
    begin: Whole
    pairs: Whole


class Rough(NamedTuple):
    """Per body, what holds on any interval of one width: how far it strays from the middle, and how fast it goes."""

    strays: Floats
    rush: Floats


@compiled
def rough_on(way: Way, width: float) -> Rough:
    """What holds on any interval of that width."""
    bodies = way.arm.link.shape[0]
    rough = Rough(np.empty(bodies), np.empty(bodies))
    for body in range(bodies):
        rough.strays[body] = strays_at_most(way, body, width)
        rough.rush[body] = rush_at_most(way, body, width)
    return rough


@compiled
def calm_from(way: Way, field: Field, pairs: Whole, rough: Rough, rate: float, law: Floats) -> tuple[Floats, Floats]:
    """Per pair, when it counts no more than any motion and is no violation.

    Returns:
        The clearance from which on that is so, metre, and the squared distance of the balls' centres in the middle of
        an interval that proves this clearance on the whole of it, m^2.
    """
    numbers, whole, half, strays, rush = field.numbers, field.whole, way.arm.half, rough.strays, rough.rush
    calm, beyond = np.empty(numbers.shape[0]), np.empty(numbers.shape[0])
    for each in range(pairs.shape[0]):
        pair = pairs[each]
        body = whole[pair, BODY]
        clear = calm_beyond(whole[pair, KIND], numbers, pair, rush[body] * rate, law)
        calm[pair] = max(clear, numbers[pair, VIOLATED_BELOW])
        far = calm[pair] + half[body] + numbers[pair, AROUND] + numbers[pair, RADII] + strays[body]
        beyond[pair] = math.inf if whole[pair, SHAPE] == PLANE else max(far, 0.0) ** 2
    return calm, beyond


@compiled
def first_level(
    nodes: Nodes,
    first: int,
    way: Way,
    field: Field,
    pairs: Whole,
    rough: Rough,
    calm: Floats,
    beyond: Floats,
    leaves: Rows,
) -> tuple[Level, int]:
    """The first cut without the pairs that are far apart, which are leaves; nodes 0 to 2 `first` are every half of it.

    The tight loop of the whole engine: plain numbers, no views.
    """
    count, step = pairs.shape[0], GRID // first
    numbers, whole, ends, rush = field.numbers, field.whole, nodes.ends, rough.rush
    level = Level(
        np.arange(first) * step,
        np.arange(1, first + 1) * step,
        np.arange(first),
        first + 1 + np.arange(first),
        np.arange(1, first + 1),
        np.zeros(first + 1, np.int64),
        np.empty(count * first, np.int64),
    )
    bodies = way.arm.link.shape[0]
    moved, centers = np.zeros(bodies, np.bool_), np.empty((bodies, 3))
    for each in range(count):
        moved[whole[pairs[each], BODY]] = True
    moving = np.flatnonzero(moved)
    low, high, of, clear, fast, bound = leaves.low, leaves.high, leaves.pair, leaves.clear, leaves.rush, leaves.bound
    clear_mid, fast_mid, asked = leaves.clear_mid, leaves.rush_mid, level.pairs
    done = near = 0
    for k in range(first):
        at = first + 1 + k
        place_all(nodes, at, way.arm, moving)
        for each in range(moving.shape[0]):
            body = moving[each]
            for i in range(3):
                centers[body, i] = 0.5 * (ends[at, body, 0, i] + ends[at, body, 1, i])
        for each in range(count):
            pair = pairs[each]
            body = whole[pair, BODY]
            x = centers[body, 0] - numbers[pair, CENTER]
            y = centers[body, 1] - numbers[pair, CENTER + 1]
            z = centers[body, 2] - numbers[pair, CENTER + 2]
            if x * x + y * y + z * z >= beyond[pair]:
                low[done], high[done], of[done] = k * step, (k + 1) * step, pair
                clear[done], fast[done], bound[done] = calm[pair], rush[body], MOVING
                clear_mid[done], fast_mid[done] = math.inf, 0.0
                done += 1
            else:
                asked[near] = pair
                near += 1
        level.begin[k + 1] = near
    return level, done


@compiled
def halved(level: Level, kept: Whole, begin: Whole, used: int) -> Level:
    """Both halves of each interval with open pairs; their middles will be the nodes from `used` on."""
    count = 0
    for k in range(level.low.shape[0]):
        count += 2 if begin[k + 1] > begin[k] else 0
    half = Level(
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        used + np.arange(count),
        np.empty(count, np.int64),
        np.zeros(count + 1, np.int64),
        np.empty(2 * kept.shape[0], np.int64),
    )
    at = rows = 0
    for k in range(level.low.shape[0]):
        if begin[k + 1] == begin[k]:
            continue
        mid = (level.low[k] + level.high[k]) // 2
        for side in range(2):
            half.low[at], half.high[at] = (level.low[k], mid) if side == 0 else (mid, level.high[k])
            half.at_low[at] = level.at_low[k] if side == 0 else level.at_mid[k]
            half.at_high[at] = level.at_mid[k] if side == 0 else level.at_high[k]
            for each in range(begin[k], begin[k + 1]):
                half.pairs[rows] = kept[each]
                rows += 1
            at += 1
            half.begin[at] = rows
    return half

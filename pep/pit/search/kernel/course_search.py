"""Branch and bound on the index of a whole course, level by level.

Level by level, as there. Rows of which the balls around both cores already prove that they cannot raise the answer
never see a distance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import AROUND, BODY, CENTER, GROUP, KIND, PLANE, RADII, SHAPE, VIOLATED_BELOW
from pep.pit.base.tier import MOVING, TIE
from pep.pit.path.straight_path import GRID
from pep.pit.search.certify import DEPTH, RESOLUTION, ROWS_MOST, VIOLATION_RESOLUTION_M
from pep.pit.search.kernel.arithmetic.bending import BENDS, STRAY, rough_rush, rough_stray, sag_on, worst_on
from pep.pit.search.kernel.arithmetic.body_poses import place
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.core_distance import core_gap, interval_gap
from pep.pit.search.kernel.arithmetic.course_poses import row_of, rows_of, with_room
from pep.pit.search.kernel.arithmetic.index_law import calm_beyond, highest_rate, pair_index, rate_at
from pep.pit.search.kernel.arithmetic.pair_rows import ball_gap
from pep.pit.search.kernel.arithmetic.row_table import (
    BOUND,
    CLEAR,
    CLEAR_MID,
    HIGH,
    LOW,
    PAIR,
    RUSH,
    RUSH_MID,
    copied,
    room_for,
    with_space,
)
from pep.pit.search.kernel.course_rows import met_near, proven_rush, rush_met

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.course_poses import Curve, CurveConfigurations
    from pep.pit.search.kernel.arithmetic.pair_rows import Field
    from pep.pit.search.kernel.arithmetic.row_table import Rows

    Whole = NDArray[np.int64]

KINDS: Final = 8  # how many kinds of pairs there are
ANSWERED: Final = 0
TOO_MANY: Final = 1
SPARE: Final = 256  # leaves beyond the first cut for which there is room at first


class CurveMet(NamedTuple):
    """Places that were met, one per group of pairs or per kind; `pair` is -1 for none.

    Attributes:
        impact: the index there; clearance, speed: of the place; key: its path parameter in 1 / GRID; pair: which pair.
    """

    impact: Floats
    clearance: Floats
    speed: Floats
    key: Whole
    pair: Whole


class CurveOutcome(NamedTuple):
    """Outcome: `ANSWERED` or `TOO_MANY`, the proven and the attained index, witnesses, violations, leaves."""

    status: int
    upper: float
    attained: float
    witnesses: CurveMet
    violated: CurveMet
    leaves: Rows


class Level(NamedTuple):
    """Intervals of one level, and each one's pairs as a stretch of `pairs`.

    Attributes:
        low, high, begin: (intervals,), and one more of `begin`.
        pairs: (rows,); gaps: (rows, 4), those in the middle; settled: (rows,), rows that were leaves without a gap.
    """

    low: Whole
    high: Whole
    begin: Whole
    pairs: Whole
    gaps: Floats
    settled: Any


class Sought(NamedTuple):
    """Question of a search: the pairs' numbers, timing and law, and room."""

    numbers: Floats
    whole: Whole
    profile: Floats
    law: Floats
    worst: Floats


@compiled
def _none_found(count: int) -> CurveMet:
    return CurveMet(
        np.zeros(count), np.full(count, math.inf), np.zeros(count), np.zeros(count, np.int64), np.full(count, -1)
    )


@compiled
def _note(found: CurveMet, at: int, index: float, clearance: float, speed: float, key: int, pair: int) -> None:
    """Notes the place when it is higher than the noted one, or as high and nearer."""
    if found.pair[at] >= 0:
        known = found.impact[at]
        if index < known or (index == known and clearance >= found.clearance[at]):
            return
    found.impact[at], found.clearance[at], found.speed[at] = index, clearance, speed
    found.key[at], found.pair[at] = key, pair


@compiled
def _at_rest(known: CurveConfigurations, curve: Curve, pairs: Whole, sought: Sought, violated: CurveMet) -> None:
    """Violations at both ends of the course, where the arm stands and no middle ever lies."""
    numbers, whole = sought.numbers, sought.whole
    nodes = known.nodes
    for end in range(2):
        at = row_of(known, end * GRID, curve)
        for each in range(pairs.shape[0]):
            pair = pairs[each]
            below, body, shape = numbers[pair, VIOLATED_BELOW], whole[pair, BODY], whole[pair, SHAPE]
            if below == -math.inf:
                continue
            if not nodes.known[at, body]:
                place(nodes, at, curve.arm, body)
            if shape != PLANE and ball_gap(nodes.ends, at, body, curve.arm.half, numbers, pair) >= below:
                continue
            gap = core_gap(nodes.ends, at, body, numbers, pair, shape)
            clearance = gap[0] - numbers[pair, RADII]
            if clearance < below:
                _note(violated, whole[pair, KIND], 0.0, clearance, 0.0, end * GRID, pair)


@compiled
def _first_level(
    known: CurveConfigurations, curve: Curve, pairs: Whole, first: int, sought: Sought, leaves: Rows
) -> tuple[Level, int]:
    """First cut without the pairs that are far apart, which are leaves.

    The tight loop: plain numbers, no views.
    """
    count, step, arm = pairs.shape[0], GRID // first, curve.arm
    numbers, whole, law = sought.numbers, sought.whole, sought.law
    bodies = arm.link.shape[0]
    low, high = np.arange(first) * step, np.arange(1, first + 1) * step
    begin, asked = np.zeros(first + 1, np.int64), np.empty(count * first, np.int64)
    moved, centers = np.zeros(bodies, np.bool_), np.empty((bodies, 3))
    strays, rush, half, ends, placed = np.empty(bodies), np.empty(bodies), arm.half, known.nodes.ends, known.nodes.known
    for each in range(count):
        moved[whole[pairs[each], BODY]] = True
    moving = np.flatnonzero(moved)
    leaf_whole, leaf_numbers = leaves.whole, leaves.numbers
    done = near = 0
    for k in range(first):
        _, at, _ = rows_of(known, low[k], high[k], curve)
        worst = worst_on(curve.bends, curve.low, curve.high, low[k], high[k], sought.worst)
        rate = highest_rate(low[k] / GRID, high[k] / GRID, sought.profile)
        for each in range(moving.shape[0]):
            body = moving[each]
            if not placed[at, body]:
                place(known.nodes, at, arm, body)
            for i in range(3):
                centers[body, i] = 0.5 * (ends[at, body, 0, i] + ends[at, body, 1, i])
            strays[body] = rough_stray(worst, body, step / GRID)
            rush[body] = rough_rush(worst, body, step / GRID, arm.radius[body])
        for each in range(count):
            pair = pairs[each]
            body = whole[pair, BODY]
            calm = calm_beyond(whole[pair, KIND], numbers, pair, rush[body] * rate, law)
            calm = max(calm, numbers[pair, VIOLATED_BELOW])
            far = calm + half[body] + numbers[pair, AROUND] + numbers[pair, RADII] + strays[body]
            x = centers[body, 0] - numbers[pair, CENTER]
            y = centers[body, 1] - numbers[pair, CENTER + 1]
            z = centers[body, 2] - numbers[pair, CENTER + 2]
            if whole[pair, SHAPE] != PLANE and x * x + y * y + z * z >= max(far, 0.0) ** 2:
                leaf_whole[done, LOW], leaf_whole[done, HIGH], leaf_whole[done, PAIR] = low[k], high[k], pair
                leaf_numbers[done, CLEAR], leaf_numbers[done, RUSH] = calm, rush[body]
                leaf_numbers[done, CLEAR_MID], leaf_numbers[done, RUSH_MID] = math.inf, 0.0
                leaf_numbers[done, BOUND] = MOVING
                done += 1
            else:
                asked[near] = pair
                near += 1
        begin[k + 1] = near
    return Level(low, high, begin, asked[:near].copy(), np.empty((near, 4)), np.zeros(near, np.bool_)), done


@compiled
def _probe(known: CurveConfigurations, curve: Curve, level: Level, sought: Sought, witnesses: CurveMet) -> float:
    """Highest index that is met at the nearest body to each obstacle, by balls, on each interval.

    So every obstacle has a witness, and there is a good guess of the answer before anything is proven.
    """
    numbers, whole, radius, half = sought.numbers, sought.whole, curve.arm.radius, curve.arm.half
    groups, pairs, begin, nodes = witnesses.pair.shape[0], level.pairs, level.begin, known.nodes
    ends, speeds, spins = nodes.ends, nodes.speed, nodes.spin
    nearest, by = np.empty(groups, np.int64), np.empty(groups)
    best = 0.0
    for k in range(level.low.shape[0]):
        low, high = level.low[k], level.high[k]
        key = (low + high) // 2
        at, rate = row_of(known, key, curve), rate_at(key / GRID, sought.profile)
        worst = worst_on(curve.bends, curve.low, curve.high, low, high, sought.worst)
        for group in range(groups):
            nearest[group], by[group] = -1, math.inf
        for each in range(begin[k], begin[k + 1]):
            pair = pairs[each]
            group, plane = whole[pair, GROUP], whole[pair, SHAPE] == PLANE
            apart = 0.0 if plane else ball_gap(ends, at, whole[pair, BODY], half, numbers, pair)
            if apart < by[group]:
                nearest[group], by[group] = pair, apart
        for group in range(groups):
            pair = nearest[group]
            if pair >= 0:
                body, shape, kind = whole[pair, BODY], whole[pair, SHAPE], whole[pair, KIND]
                gap = core_gap(ends, at, body, numbers, pair, shape)
                clearance = met_near(gap[0], shape, worst[STRAY, body]) - numbers[pair, RADII]
                speed = rush_met(speeds, spins, at, body, radius[body], worst) * rate
                index = pair_index(kind, numbers, pair, clearance, speed, sought.law)
                _note(witnesses, group, index, clearance, speed, key, pair)
                best = max(best, index)
    return best


@compiled
def _middles(
    known: CurveConfigurations,
    curve: Curve,
    level: Level,
    sought: Sought,
    best: float,
    witnesses: CurveMet,
    violated: CurveMet,
    leaves: Rows,
    done: int,
) -> tuple[float, int]:
    """Attained values of the middles.

    A row that its balls prove to be no higher than `best` is a leaf at once. The gaps of the others stand in the level.
    """
    numbers, whole, law, arm = sought.numbers, sought.whole, sought.law, curve.arm
    leaf_whole, leaf_numbers, pairs, gaps, settled = (
        leaves.whole,
        leaves.numbers,
        level.pairs,
        level.gaps,
        level.settled,
    )
    nodes, radius, half, bodies = known.nodes, arm.radius, arm.half, arm.link.shape[0]
    ends, placed, strays, rushes = nodes.ends, nodes.known, np.empty(bodies), np.empty(bodies)
    speeds, spins, impact, noted = nodes.speed, nodes.spin, witnesses.impact, witnesses.pair
    for k in range(level.low.shape[0]):
        low, high = level.low[k], level.high[k]
        key, width = (low + high) // 2, (high - low) / GRID
        _, at, _ = rows_of(known, low, high, curve)
        worst = worst_on(curve.bends, curve.low, curve.high, low, high, sought.worst)
        rate = rate_at(key / GRID, sought.profile)
        rate_most = highest_rate(low / GRID, high / GRID, sought.profile)
        strays[:] = -1.0  # nothing was told of the body yet
        for each in range(level.begin[k], level.begin[k + 1]):
            pair = pairs[each]
            body, shape, kind = whole[pair, BODY], whole[pair, SHAPE], whole[pair, KIND]
            below = numbers[pair, VIOLATED_BELOW]
            if strays[body] < 0:
                strays[body] = rough_stray(worst, body, width)
                rushes[body] = rough_rush(worst, body, width, radius[body])
                if not placed[at, body]:
                    place(nodes, at, arm, body)
            if shape != PLANE:
                apart, rush = ball_gap(ends, at, body, half, numbers, pair) - strays[body], rushes[body]
                bound = pair_index(kind, numbers, pair, apart, rush * rate_most, law)
                if apart >= below and bound <= best:
                    leaf_whole[done, LOW], leaf_whole[done, HIGH], leaf_whole[done, PAIR] = low, high, pair
                    leaf_numbers[done, CLEAR], leaf_numbers[done, RUSH] = apart, rush
                    leaf_numbers[done, CLEAR_MID], leaf_numbers[done, RUSH_MID] = math.inf, 0.0
                    leaf_numbers[done, BOUND] = bound
                    done += 1
                    settled[each] = True
                    continue
            gap = core_gap(ends, at, body, numbers, pair, shape)
            gaps[each, 0], gaps[each, 1], gaps[each, 2], gaps[each, 3] = gap
            clearance = met_near(gap[0], shape, worst[STRAY, body]) - numbers[pair, RADII]
            speed = rush_met(speeds, spins, at, body, radius[body], worst) * rate
            index = pair_index(kind, numbers, pair, clearance, speed, law)
            best, group = max(best, index), whole[pair, GROUP]
            if noted[group] < 0 or index >= impact[group]:
                _note(witnesses, group, index, clearance, speed, key, pair)
            if clearance < below:
                _note(violated, kind, 0.0, clearance, speed, key, pair)
    return best, done


@compiled
def _proofs(
    known: CurveConfigurations,
    curve: Curve,
    level: Level,
    sought: Sought,
    best: float,
    violated: CurveMet,
    leaves: Rows,
    done: int,
    last: bool,
) -> tuple[Whole, Whole, float, int]:
    """Proven bounds of the rows: leaves, their highest index, and the rows that stay open.

    Returns:
        The pairs that stay open, their stretch per interval, the highest index proven here, how many leaves there are.
    """
    kept, begin = np.empty_like(level.pairs), np.empty_like(level.begin)
    numbers, whole, law, arm, nodes = sought.numbers, sought.whole, sought.law, curve.arm, known.nodes
    leaf_whole, leaf_numbers, pairs, gaps = leaves.whole, leaves.numbers, level.pairs, level.gaps
    count, upper, settled, radii = 0, 0.0, level.settled, arm.radius
    ends, placed, speeds, spins = nodes.ends, nodes.known, nodes.speed, nodes.spin
    unmet = violated.pair
    for k in range(level.low.shape[0]):
        low, high = level.low[k], level.high[k]
        at_low, at_mid, at_high = rows_of(known, low, high, curve)
        worst = worst_on(curve.bends, curve.low, curve.high, low, high, sought.worst)
        width, rate = (high - low) / GRID, highest_rate(low / GRID, high / GRID, sought.profile)
        begin[k] = count
        for each in range(level.begin[k], level.begin[k + 1]):
            if settled[each]:
                continue
            pair, gap = pairs[each], (gaps[each, 0], gaps[each, 1], gaps[each, 2], gaps[each, 3])
            body, shape, kind = whole[pair, BODY], whole[pair, SHAPE], whole[pair, KIND]
            for at in (at_low, at_high):
                if not placed[at, body]:
                    place(nodes, at, arm, body)
            sag, radius = sag_on(worst, body, width), radii[body]
            clear = interval_gap(ends, at_low, at_mid, at_high, body, numbers, pair, shape, gap, sag)
            rush = proven_rush(speeds, spins, at_low, at_mid, at_high, body, radius, worst, width)
            bound = pair_index(kind, numbers, pair, clear, rush * rate, law)
            # Nearer than this it may hide a violation of a kind that was not met yet.
            hides = numbers[pair, VIOLATED_BELOW] - VIOLATION_RESOLUTION_M if unmet[kind] < 0 else -math.inf
            same = bound <= best + RESOLUTION and math.ceil(bound - TIE) <= math.ceil(best - TIE)
            if not ((bound <= best or same) and clear >= hides) and not last:
                kept[count] = pair
                count += 1
                continue
            leaf_whole[done, LOW], leaf_whole[done, HIGH], leaf_whole[done, PAIR] = low, high, pair
            leaf_numbers[done, CLEAR], leaf_numbers[done, RUSH] = clear, rush
            leaf_numbers[done, CLEAR_MID] = met_near(gap[0], shape, worst[STRAY, body]) - numbers[pair, RADII]
            leaf_numbers[done, RUSH_MID] = rush_met(speeds, spins, at_mid, body, radius, worst)
            leaf_numbers[done, BOUND] = bound
            done += 1
            if not bound <= upper:
                upper = bound
    begin[level.low.shape[0]] = count
    return kept, begin, upper, done


@compiled
def _halved(level: Level, kept: Whole, begin: Whole) -> Level:
    """Both halves of each interval with open pairs."""
    count, rows = 0, 2 * begin[-1]
    for k in range(level.low.shape[0]):
        count += 2 if begin[k + 1] > begin[k] else 0
    half = Level(
        np.empty(count, np.int64), np.empty(count, np.int64), np.zeros(count + 1, np.int64), np.empty(rows, np.int64),
        np.empty((rows, 4)), np.zeros(rows, np.bool_),
    )  # fmt: skip
    at = rows = 0
    for k in range(level.low.shape[0]):
        if begin[k + 1] == begin[k]:
            continue
        mid = (level.low[k] + level.high[k]) // 2
        for side in range(2):
            half.low[at], half.high[at] = (level.low[k], mid) if side == 0 else (mid, level.high[k])
            for each in range(begin[k], begin[k + 1]):
                half.pairs[rows] = kept[each]
                rows += 1
            at += 1
            half.begin[at] = rows
    return half


@entry
def certify(
    known: CurveConfigurations,
    curve: Curve,
    field: Field,
    pairs: Whole,
    groups: int,
    profile: Floats,
    law: Floats,
    floor: float,
    first: int,
) -> tuple[CurveConfigurations, CurveOutcome]:
    """The proven index of these pairs on this course.

    Args:
        known: the course's configurations.
        curve, field: the course, and all pairs.
        pairs: pairs in question.
        groups: number of groups of pairs.
        profile, law: timing and stop.
        floor: an index that holds anyway, at least `MOVING`.
        first: intervals of the first cut, a power of two.
    """
    witnesses, violated = _none_found(groups), _none_found(KINDS)
    leaves = room_for(pairs.shape[0] * first + SPARE)
    if pairs.shape[0] * first > ROWS_MOST:
        return known, CurveOutcome(TOO_MANY, floor, floor, witnesses, violated, copied(leaves, 0))
    room = np.empty((BENDS, curve.arm.link.shape[0]))
    sought = Sought(field.numbers, field.whole, profile, law, room)
    known = with_room(known, 3 * first)
    _at_rest(known, curve, pairs, sought, violated)
    level, done = _first_level(known, curve, pairs, first, sought, leaves)
    best, upper, examined = max(floor, _probe(known, curve, level, sought, witnesses)), floor, done
    for depth in range(DEPTH + 1):
        rows = level.begin[-1]
        examined += rows
        if examined > ROWS_MOST:
            return known, CurveOutcome(TOO_MANY, upper, best, witnesses, violated, copied(leaves, done))
        leaves = with_space(leaves, done, rows)
        known = with_room(known, 3 * level.low.shape[0])
        best, done = _middles(known, curve, level, sought, best, witnesses, violated, leaves, done)
        last = depth == DEPTH
        kept, begin, proven, done = _proofs(known, curve, level, sought, best, violated, leaves, done, last)
        if not proven <= upper:
            upper = proven
        if begin[-1] == 0:
            break
        level = _halved(level, kept, begin)
    return known, CurveOutcome(ANSWERED, max(best, upper), best, witnesses, violated, copied(leaves, done))

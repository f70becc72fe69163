"""Branch and bound on the index of a whole path: the same search as `pep.pit.certify`, compiled.

Level by level, as there. What is new is that most rows never see a distance: where the balls around both cores, moved
as far as levers allow, already prove that a pair cannot raise the answer, that is its proof.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.certify import DEPTH, RESOLUTION, ROWS_MOST, VIOLATION_RESOLUTION_M
from pep.pit.kernel.arm import no_nodes, place, place_all
from pep.pit.kernel.columns import (
    AROUND,
    BODY,
    CENTER,
    GROUP,
    KIND,
    PEAK,
    PLANE,
    RADII,
    SHAPE,
    VIOLATED_BELOW,
    WAY,
)
from pep.pit.kernel.compiled import compiled, entry
from pep.pit.kernel.gap import KNOTS, core_gap, interval_gap
from pep.pit.kernel.law import calm_beyond, highest_rate, pair_index, rate_at
from pep.pit.kernel.rows import (
    ball_gap,
    configuration,
    more_rows,
    no_rows,
    rush_at_most,
    rush_between,
    strays_at_most,
    taken,
)
from pep.pit.path import CHORD, GRID
from pep.pit.tier import MOVING, TIE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Nodes
    from pep.pit.kernel.rows import Field, Rows, Way
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]

KINDS: Final = 8  # how many kinds of pairs there are
ANSWERED: Final = 0
TOO_MANY: Final = 1
NODES_FIRST: Final = 96  # room for configurations at first; most questions need fewer
SPARE: Final = 256  # leaves beyond the first cut for which there is room at first


class Found(NamedTuple):
    """Places that were met, one per group of pairs or per kind; `pair` is -1 where none was.

    Attributes:
        impact: the index there; clearance, speed: of the place; key: its path parameter in 1 / GRID; pair: which pair.
    """

    impact: Floats
    clearance: Floats
    speed: Floats
    key: Whole
    pair: Whole


class Answer(NamedTuple):
    """The outcome: `ANSWERED` or `TOO_MANY`, the proven and the attained index, witnesses, violations, leaves."""

    status: int
    upper: float
    attained: float
    witnesses: Found
    violated: Found
    leaves: Rows


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


class Seen(NamedTuple):
    """Rows of which the middle was measured: their stretch per interval, their pairs and gaps."""

    begin: Whole
    pair: Whole
    gap: Floats


@compiled
def _none_found(count: int) -> Found:
    return Found(
        np.zeros(count), np.full(count, math.inf), np.zeros(count), np.zeros(count, np.int64), np.full(count, -1)
    )


@compiled
def _note(found: Found, at: int, index: float, clearance: float, speed: float, key: int, pair: int) -> None:
    """The place stands there when it is higher than what stands, or as high and nearer."""
    if found.pair[at] >= 0:
        known = found.impact[at]
        if index < known or (index == known and clearance >= found.clearance[at]):
            return
    found.impact[at], found.clearance[at], found.speed[at] = index, clearance, speed
    found.key[at], found.pair[at] = key, pair


@compiled
def _rough(way: Way, width: float) -> Rough:
    bodies = way.arm.link.shape[0]
    rough = Rough(np.empty(bodies), np.empty(bodies))
    for body in range(bodies):
        rough.strays[body] = strays_at_most(way, body, width)
        rough.rush[body] = rush_at_most(way, body, width)
    return rough


@compiled
def _at_rest(nodes: Nodes, first: int, way: Way, field: Field, pairs: Whole, violated: Found, knots: Floats) -> None:
    """Violations at both ends of the path, where the arm stands and no middle ever lies; nodes 0 and `first`."""
    ends, known, half, numbers, whole = nodes.ends, nodes.known, way.arm.half, field.numbers, field.whole
    for each in range(pairs.shape[0]):
        pair = pairs[each]
        below, body, shape = numbers[pair, VIOLATED_BELOW], whole[pair, BODY], whole[pair, SHAPE]
        if below == -math.inf:
            continue
        for end in range(2):
            at = end * first
            if not known[at, body]:
                place(nodes, at, way.arm, body)
            if shape != PLANE and ball_gap(ends, at, body, half, numbers, pair) >= below:
                continue
            clearance = core_gap(ends, at, body, numbers, pair, shape, knots)[0] - numbers[pair, RADII]
            if clearance < below:
                _note(violated, whole[pair, KIND], 0.0, clearance, 0.0, end * GRID, pair)


@compiled
def _calm(way: Way, field: Field, pairs: Whole, rough: Rough, rate: float, law: Floats) -> tuple[Floats, Floats]:
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
def _first_level(
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
def _probe(
    nodes: Nodes, level: Level, way: Way, field: Field, profile: Floats, law: Floats, witnesses: Found, knots: Floats
) -> float:
    """The highest index that is met where, on each interval, something of each obstacle comes nearest by its balls.

    A good guess of the answer before anything is proven: the better it is, the less is left to prove.
    """
    ends, half, numbers, whole, radius = nodes.ends, way.arm.half, field.numbers, field.whole, way.arm.radius
    groups, pairs, begin = witnesses.pair.shape[0], level.pairs, level.begin
    nearest, by = np.empty(groups, np.int64), np.empty(groups)
    best = 0.0
    for k in range(level.low.shape[0]):
        at, key = level.at_mid[k], (level.low[k] + level.high[k]) // 2
        rate = rate_at(key / GRID, profile)
        for group in range(groups):
            nearest[group], by[group] = -1, math.inf
        for each in range(begin[k], begin[k + 1]):
            pair = pairs[each]
            group = whole[pair, GROUP]
            plane = whole[pair, SHAPE] == PLANE
            apart = 0.0 if plane else ball_gap(ends, at, whole[pair, BODY], half, numbers, pair)
            if apart < by[group]:
                nearest[group], by[group] = pair, apart
        for group in range(groups):
            pair = nearest[group]
            if pair >= 0:
                body = whole[pair, BODY]
                gap = core_gap(ends, at, body, numbers, pair, whole[pair, SHAPE], knots)
                clearance = gap[0] - numbers[pair, RADII]
                speed = (nodes.speed[at, body] + radius[body] * nodes.spin[at, body]) * rate
                index = pair_index(whole[pair, KIND], numbers, pair, clearance, speed, law)
                _note(witnesses, group, index, clearance, speed, key, pair)
                best = max(best, index)
    return best


@compiled
def _middles(
    nodes: Nodes,
    level: Level,
    way: Way,
    field: Field,
    profile: Floats,
    law: Floats,
    rough: Rough,
    best: float,
    witnesses: Found,
    violated: Found,
    leaves: Rows,
    done: int,
    knots: Floats,
) -> tuple[Seen, float, int]:
    """What the middles attain. A row that its balls prove to be no higher than `best` is a leaf at once."""
    rows = level.begin[-1]
    seen = Seen(np.empty_like(level.begin), np.empty(rows, np.int64), np.empty((rows, 4)))
    ends, known, speeds, spins = nodes.ends, nodes.known, nodes.speed, nodes.spin
    numbers, whole, half, radius = field.numbers, field.whole, way.arm.half, way.arm.radius
    strays, rush, pairs, begin, seen_pair, seen_gap = (
        rough.strays,
        rough.rush,
        level.pairs,
        level.begin,
        seen.pair,
        seen.gap,
    )
    leaf_low, leaf_high, leaf_pair, leaf_bound = leaves.low, leaves.high, leaves.pair, leaves.bound
    leaf_clear, leaf_rush, leaf_clear_mid, leaf_rush_mid = leaves.clear, leaves.rush, leaves.clear_mid, leaves.rush_mid
    count = 0
    for k in range(level.low.shape[0]):
        low, high, at = level.low[k], level.high[k], level.at_mid[k]
        key = (low + high) // 2
        rate, rate_most = rate_at(key / GRID, profile), highest_rate(low / GRID, high / GRID, profile)
        seen.begin[k] = count
        for each in range(begin[k], begin[k + 1]):
            pair = pairs[each]
            body, shape, kind, below = (
                whole[pair, BODY],
                whole[pair, SHAPE],
                whole[pair, KIND],
                numbers[pair, VIOLATED_BELOW],
            )
            if not known[at, body]:
                place(nodes, at, way.arm, body)
            if shape != PLANE:
                apart = ball_gap(ends, at, body, half, numbers, pair) - strays[body]
                bound = pair_index(kind, numbers, pair, apart, rush[body] * rate_most, law)
                if apart >= below and bound <= best:
                    leaf_low[done], leaf_high[done], leaf_pair[done], leaf_bound[done] = low, high, pair, bound
                    leaf_clear[done], leaf_rush[done], leaf_clear_mid[done] = apart, rush[body], math.inf
                    leaf_rush_mid[done] = 0.0
                    done += 1
                    continue
            gap = core_gap(ends, at, body, numbers, pair, shape, knots)
            seen_pair[count] = pair
            seen_gap[count, 0], seen_gap[count, 1], seen_gap[count, 2], seen_gap[count, 3] = gap
            count += 1
            clearance, speed = gap[0] - numbers[pair, RADII], (speeds[at, body] + radius[body] * spins[at, body]) * rate
            index = pair_index(kind, numbers, pair, clearance, speed, law)
            best = max(best, index)
            _note(witnesses, whole[pair, GROUP], index, clearance, speed, key, pair)
            if clearance < below:
                _note(violated, kind, 0.0, clearance, speed, key, pair)
    seen.begin[level.low.shape[0]] = count
    return seen, best, done


@compiled
def _proofs(
    nodes: Nodes,
    level: Level,
    seen: Seen,
    way: Way,
    field: Field,
    profile: Floats,
    law: Floats,
    rough: Rough,
    best: float,
    violated: Found,
    leaves: Rows,
    done: int,
    last: bool,
) -> tuple[Whole, Whole, float, int]:
    """What is proven of the rows that were seen: leaves, their highest index, and the rows to be looked at closer.

    Returns:
        The pairs that stay open, their stretch per interval, the highest index proven here, how many leaves there are.
    """
    width = (level.high[0] - level.low[0]) / GRID
    kept, begin = np.empty_like(seen.pair), np.empty_like(seen.begin)
    ends, known, numbers, whole, second = nodes.ends, nodes.known, field.numbers, field.whole, way.bends.second
    leaf_low, leaf_high, leaf_pair, leaf_bound = leaves.low, leaves.high, leaves.pair, leaves.bound
    leaf_clear, leaf_rush, leaf_clear_mid, leaf_rush_mid = leaves.clear, leaves.rush, leaves.clear_mid, leaves.rush_mid
    count, upper = 0, 0.0
    for k in range(level.low.shape[0]):
        low, high = level.low[k], level.high[k]
        at_low, at_mid, at_high = level.at_low[k], level.at_mid[k], level.at_high[k]
        rate = highest_rate(low / GRID, high / GRID, profile)
        begin[k] = count
        for row in range(seen.begin[k], seen.begin[k + 1]):
            pair = seen.pair[row]
            gap = (seen.gap[row, 0], seen.gap[row, 1], seen.gap[row, 2], seen.gap[row, 3])
            body, shape, kind, radii = whole[pair, BODY], whole[pair, SHAPE], whole[pair, KIND], numbers[pair, RADII]
            # Nearer than this it may hide a violation of a kind that was not met yet.
            hides = numbers[pair, VIOLATED_BELOW] if violated.pair[kind] < 0 else -math.inf
            # The middle's distance less what levers allow often settles it without a look at the ends.
            clear, rush = gap[0] - radii - rough.strays[body], rough.rush[body]
            bound = pair_index(kind, numbers, pair, clear, rush * rate, law)
            if not (bound <= best and clear >= hides):
                for at in (at_low, at_high):
                    if not known[at, body]:
                        place(nodes, at, way.arm, body)
                sag = second[body] * width * width / CHORD
                clear = interval_gap(ends, at_low, at_mid, at_high, body, numbers, pair, shape, gap, sag)
                rush = rush_between(nodes, at_low, at_mid, at_high, way, body, width)
                bound = pair_index(kind, numbers, pair, clear, rush * rate, law)
                same = bound <= best + RESOLUTION and math.ceil(bound - TIE) <= math.ceil(best - TIE)
                if not ((bound <= best or same) and clear >= hides - VIOLATION_RESOLUTION_M) and not last:
                    kept[count] = pair
                    count += 1
                    continue
            leaf_low[done], leaf_high[done], leaf_pair[done], leaf_bound[done] = low, high, pair, bound
            leaf_clear[done], leaf_rush[done], leaf_clear_mid[done] = clear, rush, gap[0] - radii
            leaf_rush_mid[done] = nodes.speed[at_mid, body] + way.arm.radius[body] * nodes.spin[at_mid, body]
            done += 1
            upper = max(upper, bound)
    begin[level.low.shape[0]] = count
    return kept, begin, upper, done


@compiled
def _halved(level: Level, kept: Whole, begin: Whole, used: int) -> Level:
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


@entry
def certify(
    way: Way, field: Field, pairs: Whole, groups: int, profile: Floats, law: Floats, floor: float, first: int
) -> Answer:
    """The proven index of these pairs on this path (see `pep.pit.certify.certify`).

    Args:
        way, field: the path, and all pairs.
        pairs: which to ask about.
        groups: how many groups of pairs there are.
        profile, law: timing and stop.
        floor: an index that holds anyway, at least `MOVING`.
        first: intervals of the first cut, a power of two.
    """
    witnesses, violated, knots = _none_found(groups), _none_found(KINDS), np.empty(KNOTS)
    leaves = no_rows(pairs.shape[0] * first + SPARE)
    if pairs.shape[0] * first > ROWS_MOST:
        return Answer(TOO_MANY, floor, floor, witnesses, violated, taken(leaves, 0))
    nodes = no_nodes(NODES_FIRST, way.arm.link.shape[0])
    used = 0
    for k in range(first + 1):
        nodes = configuration(nodes, used, way, k * (GRID // first))
        used += 1
    for k in range(first):
        nodes = configuration(nodes, used, way, k * (GRID // first) + GRID // first // 2)
        used += 1
    _at_rest(nodes, first, way, field, pairs, violated, knots)
    rough = _rough(way, 1.0 / first)
    calm, beyond = _calm(way, field, pairs, rough, profile[PEAK] / profile[WAY], law)
    level, done = _first_level(nodes, first, way, field, pairs, rough, calm, beyond, leaves)
    best = max(floor, _probe(nodes, level, way, field, profile, law, witnesses, knots))
    upper, examined = floor, done
    for depth in range(DEPTH + 1):
        rows = level.begin[-1]
        examined += rows
        if examined > ROWS_MOST:
            return Answer(TOO_MANY, upper, best, witnesses, violated, taken(leaves, done))
        if done + rows > leaves.low.shape[0]:
            leaves = more_rows(leaves, done, rows)
        seen, best, done = _middles(
            nodes, level, way, field, profile, law, rough, best, witnesses, violated, leaves, done, knots
        )
        kept, begin, proven, done = _proofs(
            nodes, level, seen, way, field, profile, law, rough, best, violated, leaves, done, depth == DEPTH
        )
        upper = max(upper, proven)
        if begin[-1] == 0:
            break
        level = _halved(level, kept, begin, used)
        rough = _rough(way, (level.high[0] - level.low[0]) / GRID)
        for k in range(level.low.shape[0]):
            nodes = configuration(nodes, used, way, (level.low[k] + level.high[k]) // 2)
            used += 1
    return Answer(ANSWERED, max(upper, best), best, witnesses, violated, taken(leaves, done))

"""Branch and bound on the index of a whole path: the same search as `pep.pit.certify`, compiled.

Level by level, as there. What is new is that most rows never see a distance: where the balls around both cores, moved
as far as levers allow, already prove that a pair cannot raise the answer, that is its proof.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.certify import DEPTH, RESOLUTION, ROWS_MOST, VIOLATION_RESOLUTION_M
from pep.pit.kernel.arm import no_nodes, place
from pep.pit.kernel.columns import BODY, GROUP, KIND, PEAK, PLANE, RADII, SHAPE, VIOLATED_BELOW, WAY
from pep.pit.kernel.compiled import compiled, entry
from pep.pit.kernel.gap import KNOTS, core_gap, interval_gap
from pep.pit.kernel.law import highest_rate, pair_index, rate_at
from pep.pit.kernel.levels import calm_from, first_level, halved, rough_on
from pep.pit.kernel.rows import ball_gap, configuration, more_rows, no_rows, rush_between, taken
from pep.pit.path import CHORD, GRID
from pep.pit.tier import TIE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Nodes
    from pep.pit.kernel.levels import Level, Rough
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
    rough = rough_on(way, 1.0 / first)
    calm, beyond = calm_from(way, field, pairs, rough, profile[PEAK] / profile[WAY], law)
    level, done = first_level(nodes, first, way, field, pairs, rough, calm, beyond, leaves)
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
        level = halved(level, kept, begin, used)
        rough = rough_on(way, (level.high[0] - level.low[0]) / GRID)
        for k in range(level.low.shape[0]):
            nodes = configuration(nodes, used, way, (level.low[k] + level.high[k]) // 2)
            used += 1
    return Answer(ANSWERED, max(upper, best), best, witnesses, violated, taken(leaves, done))

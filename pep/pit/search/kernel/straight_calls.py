"""Entries for Python: the proven index of a straight joint path, and the speed for a lower tier."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from pep.pit.base.pair_columns import (
    ACCELERATION,
    BRAKE,
    BRAKING,
    KIND,
    LAW,
    PEAK,
    PROFILE,
    TOP,
    TRAVEL,
    WAY,
)
from pep.pit.base.tier import HIGHEST, MOVING, TIE
from pep.pit.search.certify import SPEED_STEPS
from pep.pit.search.kernel.arithmetic.body_poses import arm_in, bends_of
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.heap import push
from pep.pit.search.kernel.arithmetic.index_law import pair_index
from pep.pit.search.kernel.arithmetic.pair_rows import Field, StraightPath
from pep.pit.search.kernel.interval_tree import HIGHEST_RATE, SPANS, rate
from pep.pit.search.kernel.scratch import Room, laid_out
from pep.pit.search.kernel.search_columns import (
    ANSWERED,
    BOUND,
    CLEAR,
    COMMANDED,
    DECELERATION,
    DELAY,
    FINAL,
    HALVED,
    KINDS,
    LEAF,
    LEVEL_LOWEST,
    MET,
    MET_PAIR,
    NOBODY,
    PAIR,
    RUSH,
    SLOWEST,
    SPAN_OF,
    STAGE,
    STOP,
    Met,
    none_met,
    ranked,
    table_of,
)
from pep.pit.search.kernel.straight_search import explored, leaf_count, leaves_of, searched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.heap import Heap
    from pep.pit.search.kernel.interval_tree import Tree
    from pep.pit.search.kernel.search_columns import SearchRows

    Whole = NDArray[np.int64]


@compiled
def _timed(profile: Floats, law: Floats, stop: Floats, speed: float) -> tuple[Floats, Floats]:
    """Profile and law of the same motion at another commanded speed (`motion.Profile`, `separation.stopping`)."""
    timing, rule = profile.copy(), law.copy()
    way, up, down = profile[WAY], profile[ACCELERATION], profile[BRAKING]
    timing[PEAK] = min(speed, math.sqrt(2.0 * way * up * (down / (up + down))))
    timing[TOP] = min(0.5 * timing[PEAK] ** 2 / up / way, 1.0)
    ramp = timing[PEAK] / stop[DECELERATION]
    rule[BRAKE], rule[TRAVEL] = stop[DELAY] + ramp, stop[DELAY] + 0.5 * ramp
    return timing, rule


@compiled
def _slower(
    tree: Tree,
    rows: SearchRows,
    heap: Heap,
    way: StraightPath,
    table: Floats,
    field: Field,
    profile: Floats,
    law: Floats,
    stop: Floats,
    met: Met,
    target: float,
) -> float:
    """Highest speed, to a step of the bisection, whose index is proven to be at most `target`; else -1.

    What counts no more at the commanded speed counts no more at a lower one: only the other rows are asked again. The
    rows and what was met are spent.
    """
    whole, numbers, kinds, laws = rows.whole, rows.numbers, field.whole, field.numbers
    spans, rates = tree.spans, tree.rates
    over, known = np.zeros(rows.used[0], np.bool_), rows.used[0]
    for row in range(known):
        over[row] = numbers[row, BOUND] > target
    met.violated[:, MET_PAIR] = 0.0  # no violation is looked for
    proven, low, high = NOBODY, stop[SLOWEST], stop[COMMANDED]
    for step in range(SPEED_STEPS + 1):
        speed = low if step == 0 else 0.5 * (low + high)
        timing, rule = _timed(profile, law, stop, speed)
        heap.used[0], rows.used[1] = 0, 0
        for span in range(tree.counts[SPANS]):
            rate(spans, rates, span, timing)
        fits = True
        for row in range(rows.used[0]):
            if whole[row, STAGE] == HALVED or (row < known and not over[row]):
                continue
            span, pair = whole[row, SPAN_OF], whole[row, PAIR]
            speed_most = numbers[row, RUSH] * rates[span, HIGHEST_RATE]
            bound = pair_index(kinds[pair, KIND], laws, pair, numbers[row, CLEAR], speed_most, rule)
            numbers[row, BOUND] = bound
            if bound > target + TIE:
                if whole[row, STAGE] == FINAL or heap.used[0] + 4 > heap.key.shape[0]:
                    fits = False
                    break
                push(heap.key, heap.row, heap.used, bound, row)
        if fits:
            finished, best = explored(
                tree, way, table, field, rows, heap, timing, rule, met, target, target + TIE, LEVEL_LOWEST, 0
            )
            fits = finished and best <= target + TIE
            for row in range(rows.used[0]):  # rows that could not be halved any more may still be above
                if fits and whole[row, STAGE] == FINAL:
                    fits = numbers[row, BOUND] <= target + TIE
        if fits:
            proven = low = speed
        elif step == 0:
            return NOBODY
        else:
            high = speed
    return proven


@entry
def certify(
    numbers: Floats,
    whole: Whole,
    flags: Any,
    room: int,
    arm_numbers: Floats,
    arm_whole: Whole,
    pair_balls: Floats,
    pair_numbers: Floats,
    pair_whole: Whole,
    pairs: Whole,
    groups: int,
    floor: float,
    looks: int,
    slows: bool,
) -> tuple[int, float, float, float, int, int, Floats, Whole]:
    """The proven index of these pairs on this path.

    Few arrays and no tuples of them: numba looks at each that Python hands over, which takes as long as the search when
    none of it is in the processor's cache.

    Args:
        numbers, whole, flags, room: a `Room` for the rows of the first cut at least, with what is asked in it: start
            and target of the joints, timing, law, and `STOP` numbers that a slower speed is found by.
        arm_numbers, arm_whole: the arm (`arm.blocks_of`).
        pair_balls, pair_numbers, pair_whole: all pairs (`rows.Field`).
        pairs: pairs in question.
        groups: number of groups of pairs.
        floor: an index that holds anyway, at least `MOVING`.
        looks: at each group that does not decide, so that it can be told of.
        slows: whether a slower speed is looked for.

    Returns:
        `ANSWERED`, `TOO_MANY` or `HIDDEN`, the proven and the attained index, and the highest speed at which the index
        of these pairs is proven to be a whole tier lower, or -1; then how many witnesses there are and how many
        violations, and an array of those: first the witnesses in `MET` columns, highest first, then the violations,
        then the leaves in `LEAF` columns; last, for each pair, the spans of the first cut on which it is far apart and
        counts no more than any motion, as bits: there it has no leaf.
    """
    arm, field = arm_in(arm_numbers, arm_whole), Field(pair_balls, pair_numbers, pair_whole)
    joints = arm.offsets.shape[0]
    start, at = numbers[:joints], 2 * joints
    delta = numbers[joints:at] - start
    profile, at = numbers[at : at + PROFILE], at + PROFILE
    law, at = numbers[at : at + LAW], at + LAW
    stop = numbers[at : at + STOP]
    way = StraightPath(arm, start, delta, bends_of(arm, delta))
    table = table_of(arm, way.bends)
    met = Met(none_met(groups), none_met(KINDS), np.empty((groups, looks), np.int64))
    tree, rows, heap = laid_out(Room(numbers, whole, flags, room), table.shape[0], joints)
    far = np.zeros(field.whole.shape[0], np.int64)
    tree, rows, heap, status, best = searched(
        tree, rows, heap, way, table, field, pairs, profile, law, floor, looks, met, far
    )
    witnesses, violated = ranked(met.witnesses), ranked(met.violated)
    told, broken = witnesses.shape[0], violated.shape[0]
    found = np.empty((told + broken + leaf_count(rows), LEAF))
    for row in range(told + broken):
        for column in range(MET):
            found[row, column] = witnesses[row, column] if row < told else violated[row - told, column]
    upper = max(floor, best, leaves_of(tree, rows, found, told + broken))
    slower, target = NOBODY, math.ceil(min(upper, HIGHEST) - TIE) - 1.0
    if slows and status == ANSWERED and broken == 0 and target >= MOVING:
        slower = _slower(tree, rows, heap, way, table, field, profile, law, stop, met, target)
    return status, upper, best, slower, told, broken, found, far

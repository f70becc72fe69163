"""Branch and bound on the index of a whole path, the most doubtful row first (see `pep.pit.search.certify`).

A row is a pair on a span of the path. At first all that is known of it is how far apart the balls around both cores
are; most rows are settled by that. What may still raise the answer is looked at closer, the highest bound first: the
distance in the middle, then what the nodes at both ends prove, then both halves. Once the highest bound is settled, all
are.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pep.pit.base.pair_columns import BODY, GROUP, KIND, RADII, SHAPE, VIOLATED_BELOW
from pep.pit.base.tier import MOVING
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.certify import DEPTH, ROWS_MOST, VIOLATION_RESOLUTION_M
from pep.pit.search.kernel import interval_tree as trees
from pep.pit.search.kernel.arithmetic import heap as heaps
from pep.pit.search.kernel.arithmetic.body_poses import place, put
from pep.pit.search.kernel.arithmetic.compilation import compiled, lent
from pep.pit.search.kernel.arithmetic.core_distance import core_gap, interval_gap
from pep.pit.search.kernel.arithmetic.heap import heaped, lower, pop, push
from pep.pit.search.kernel.arithmetic.index_law import pair_index
from pep.pit.search.kernel.broad_phase import first_rows
from pep.pit.search.kernel.coupling import in_step_index, lowered
from pep.pit.search.kernel.interval_tree import (
    AT_HIGH,
    AT_LOW,
    AT_MID,
    FIRST_LEVEL,
    HIGH,
    HIGHEST_RATE,
    LEFT,
    LEVEL,
    LOW,
    MIDDLE_RATE,
    WHOLE_LEAF,
    halve,
    is_full,
    plant,
    stand,
)
from pep.pit.search.kernel.search_columns import (
    ANSWERED,
    AWAY,
    BALLS,
    BOUND,
    CLEAR,
    CLEAR_MID,
    FINAL,
    HALVED,
    HIDDEN,
    LEAF,
    LEAF_HIGH,
    LEAF_LOW,
    LEAF_NUMBERS,
    LEAF_PAIR,
    MET_INDEX,
    MET_PAIR,
    MIDDLE,
    NOBODY,
    NODES,
    PAIR,
    RADIUS,
    RUSH,
    RUSH_MID,
    SECOND,
    SPAN_OF,
    SPIN_SECOND,
    STAGE,
    STRAYS,
    THIRD,
    TOO_MANY,
    note,
    settled,
    with_room,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.core_distance import Gap
    from pep.pit.search.kernel.arithmetic.heap import Heap
    from pep.pit.search.kernel.arithmetic.pair_rows import Field, StraightPath
    from pep.pit.search.kernel.interval_tree import Tree
    from pep.pit.search.kernel.search_columns import Met, SearchRows

    Whole = NDArray[np.int64]

NOT_LOOKED: Final = -1


@lent
def _by_nodes(
    ends: Floats,
    speeds: Floats,
    spins: Floats,
    table: Floats,
    laws: Floats,
    first: int,
    middle: int,
    last: int,
    body: int,
    pair: int,
    shape: int,
    gap: Gap,
    bend: float,
) -> tuple[float, float]:
    """Clearance and speed per unit of ds/dt that a span's three nodes prove, by the gap in its middle.

    `bend` is what a bound on a second derivative is multiplied with to bound how far its chord is left.
    """
    clear = interval_gap(ends, first, middle, last, body, laws, pair, shape, gap, table[body, SECOND] * bend)
    speed = max(speeds[first, body], speeds[middle, body], speeds[last, body]) + table[body, THIRD] * bend
    spin = max(spins[first, body], spins[middle, body], spins[last, body]) + table[body, SPIN_SECOND] * bend
    return clear, speed + table[body, RADIUS] * spin


@lent
def explored(
    tree: Tree,
    way: StraightPath,
    table: Floats,
    field: Field,
    rows: SearchRows,
    heap: Heap,
    profile: Floats,
    law: Floats,
    met: Met,
    best: float,
    ceiling: float,
    deepest: int,
    looks: int,
) -> tuple[bool, float]:
    """(all rows are settled, highest attained index); where the first is false, more room is needed.

    One function, however long: a call with arrays counts a reference to each, and these calls would cost more than all
    the rest.
    """
    whole, numbers, doubts, used = rows.whole, rows.numbers, rows.doubts, rows.used
    keys, key_rows, key_count = heap.key, heap.row, heap.used
    nodes, arm, spans, rates, posed = tree.nodes, way.arm, tree.spans, tree.rates, tree.posed
    frames, turning, ends, speeds, swerves = nodes.frames, nodes.turning, nodes.ends, nodes.speed, nodes.swerve
    spins, known, link, reference, own = nodes.spin, nodes.known, arm.link, arm.reference, arm.ends
    laws, kinds = field.numbers, field.whole
    witnesses, violated, top = met.witnesses, met.violated, met.top
    look, on_top, bend = NOT_LOOKED, False, 0.0
    while True:
        # 1. Which row: the one with the highest bound, or one that may hide a violation, or one that tells of a group.
        if used[0] + 2 > whole.shape[0] or key_count[0] + 2 > keys.shape[0]:
            return False, best
        on_top = key_count[0] > 0 and not settled(keys[0], best)
        if on_top:
            row = key_rows[0]
            if whole[row, STAGE] >= FINAL or settled(numbers[row, BOUND], best):  # looked at since, in doubt
                pop(keys, key_rows, key_count)
                continue
        elif used[1] > 0:
            used[1] -= 1
            row = doubts[used[1]]
            if whole[row, STAGE] >= FINAL or not _hides(row, whole, numbers, laws, kinds, violated):
                continue
        else:
            if look == NOT_LOOKED:
                _tops(whole, numbers, kinds, top, used[0], looks)
                look = 0
            if look == top.shape[0] * looks:
                return True, best
            row = top[look // looks, look % looks]
            look += 1
            if row < 0 or numbers[row, BOUND] <= witnesses[kinds[whole[row, PAIR], GROUP], MET_INDEX]:
                continue
        span, pair, stage = whole[row, SPAN_OF], whole[row, PAIR], whole[row, STAGE]
        middle = spans[span, AT_MID]
        body, shape, kind, below = kinds[pair, BODY], kinds[pair, SHAPE], kinds[pair, KIND], laws[pair, VIOLATED_BELOW]
        # The body stands in the middle for the first look, at both ends for the second.
        first, last = (middle, middle) if stage == BALLS else (spans[span, AT_LOW], spans[span, AT_HIGH])
        if stage < NODES:
            for side in range(2):
                at = first if side == 0 else last
                if not posed[at]:
                    stand(tree, way, at)
                if not known[at, body]:
                    put(frames, turning, ends, speeds, swerves, spins, known, link, reference, own, at, body)
        if stage == BALLS:
            # 2. The distance in the middle. Less the bound by levers, it often settles the row.
            gap = core_gap(ends, middle, body, laws, pair, shape)
            clear, rush = gap[0] - laws[pair, RADII], speeds[middle, body] + table[body, RADIUS] * spins[middle, body]
            numbers[row, CLEAR_MID], numbers[row, RUSH_MID] = clear, rush
            numbers[row, CLEAR] = clear - numbers[row, STRAYS]
            numbers[row, AWAY], numbers[row, AWAY + 1], numbers[row, AWAY + 2] = gap[1], gap[2], gap[3]
            speed = rush * rates[span, MIDDLE_RATE]
            index = pair_index(kind, laws, pair, clear, speed, law)
            best = max(best, index)
            if best > ceiling:
                return True, best
            key = (spans[span, LOW] + spans[span, HIGH]) // 2
            note(witnesses, kinds[pair, GROUP], index, clear, speed, key, pair)
            if clear < below:
                note(violated, kind, 0.0, clear, speed, key, pair)
            whole[row, STAGE] = MIDDLE
        elif stage == MIDDLE:
            # 3. What the nodes at both ends prove.
            width = (spans[span, HIGH] - spans[span, LOW]) / GRID
            bend = width * width / CHORD
            gap = (0.0, numbers[row, AWAY], numbers[row, AWAY + 1], numbers[row, AWAY + 2])
            numbers[row, CLEAR], numbers[row, RUSH] = _by_nodes(
                ends, speeds, spins, table, laws, first, middle, last, body, pair, shape, gap, bend
            )
            whole[row, STAGE] = NODES
        elif spans[span, LEVEL] >= deepest:
            whole[row, STAGE] = FINAL
            continue
        else:
            # 4. Both halves, each with all that its nodes prove: a halved row needs the full look.
            if spans[span, LEFT] == WHOLE_LEAF and is_full(tree):
                if not on_top:
                    used[1] += 1
                return False, best
            if on_top:
                pop(keys, key_rows, key_count)
            left, width = halve(tree, way, profile, span), 0.5 * (spans[span, HIGH] - spans[span, LOW]) / GRID
            bend = width * width / CHORD
            whole[row, STAGE] = HALVED
            for half in range(left, left + 2):
                first, middle, last, new = spans[half, AT_LOW], spans[half, AT_MID], spans[half, AT_HIGH], used[0]
                used[0] = new + 1
                if not known[middle, body]:
                    put(frames, turning, ends, speeds, swerves, spins, known, link, reference, own, middle, body)
                gap = core_gap(ends, middle, body, laws, pair, shape)
                clear, rush = (
                    gap[0] - laws[pair, RADII],
                    speeds[middle, body] + table[body, RADIUS] * spins[middle, body],
                )
                speed = rush * rates[half, MIDDLE_RATE]
                index, key = (
                    pair_index(kind, laws, pair, clear, speed, law),
                    (spans[half, LOW] + spans[half, HIGH]) // 2,
                )
                best = max(best, index)
                note(witnesses, kinds[pair, GROUP], index, clear, speed, key, pair)
                if clear < below:
                    note(violated, kind, 0.0, clear, speed, key, pair)
                numbers[new, CLEAR_MID], numbers[new, RUSH_MID] = clear, rush
                clear, rush = _by_nodes(
                    ends, speeds, spins, table, laws, first, middle, last, body, pair, shape, gap, bend
                )
                bound = pair_index(kind, laws, pair, clear, rush * rates[half, HIGHEST_RATE], law)
                if not settled(bound, best):
                    in_step = in_step_index(
                        ends, speeds, spins, table, laws, spans[half, LOW], spans[half, HIGH], first, middle, last,
                        body, pair, shape, kind, gap, bend, profile, law,
                    )  # fmt: skip
                    bound = lowered(bound, in_step, best)
                whole[new, SPAN_OF], whole[new, PAIR], whole[new, STAGE] = half, pair, NODES
                numbers[new, CLEAR], numbers[new, RUSH], numbers[new, BOUND] = clear, rush, bound
                if not settled(bound, best):
                    push(keys, key_rows, key_count, bound, new)
                if clear < below and violated[kind, MET_PAIR] == NOBODY:
                    doubts[used[1]] = new
                    used[1] += 1
            if best > ceiling:
                return True, best
            continue
        bound = pair_index(kind, laws, pair, numbers[row, CLEAR], numbers[row, RUSH] * rates[span, HIGHEST_RATE], law)
        if stage == MIDDLE and not settled(bound, best):
            in_step = in_step_index(
                ends, speeds, spins, table, laws, spans[span, LOW], spans[span, HIGH], first, middle, last,
                body, pair, shape, kind, gap, bend, profile, law,
            )  # fmt: skip
            bound = lowered(bound, in_step, best)
        numbers[row, BOUND] = bound
        # What is settled stays so, since the best only rises: it need not be in the heap.
        if settled(bound, best):
            if on_top:
                pop(keys, key_rows, key_count)
        elif on_top:
            lower(keys, key_rows, key_count, bound)
        else:
            push(keys, key_rows, key_count, bound, row)
        if look == NOT_LOOKED and numbers[row, CLEAR] < below and violated[kind, MET_PAIR] == NOBODY:
            doubts[used[1]] = row
            used[1] += 1


@lent
def _hides(row: int, whole: Whole, numbers: Floats, laws: Floats, kinds: Whole, violated: Floats) -> bool:
    """True where the row may hide a violation of a kind that was not met yet."""
    pair = whole[row, PAIR]
    short = VIOLATION_RESOLUTION_M if whole[row, STAGE] >= NODES else 0.0
    if numbers[row, CLEAR] >= laws[pair, VIOLATED_BELOW] - short:
        return False
    return violated[kinds[pair, KIND], MET_PAIR] == NOBODY


@lent
def _any_hides(rows: SearchRows, field: Field, violated: Floats) -> bool:
    """True where a row that cannot be halved any more may hide a violation of an unmet kind."""
    whole, numbers, laws, kinds = rows.whole, rows.numbers, field.numbers, field.whole
    for row in range(rows.used[0]):
        if whole[row, STAGE] == FINAL and _hides(row, whole, numbers, laws, kinds, violated):
            return True
    return False


@lent
def _tops(whole: Whole, numbers: Floats, kinds: Whole, top: Whole, count: int, looks: int) -> None:
    """Rows without a known distance that may raise each group most; -1 where there are no more."""
    top[:] = -1
    for row in range(count):
        bound = numbers[row, BOUND]
        if whole[row, STAGE] != BALLS or bound <= MOVING:
            continue
        group, clear, at = kinds[whole[row, PAIR], GROUP], numbers[row, CLEAR], looks
        while at > 0:
            other = top[group, at - 1]
            if other >= 0:
                theirs = numbers[other, BOUND]
                if bound < theirs or (bound == theirs and clear >= numbers[other, CLEAR]):
                    break
                if at < looks:
                    top[group, at] = other
            at -= 1
        if at < looks:
            top[group, at] = row


@lent
def _at_rest(tree: Tree, way: StraightPath, field: Field, rows: SearchRows, violated: Floats) -> None:
    """Violations at both ends of the path, where the arm stands and no middle ever lies."""
    whole, numbers, spans, nodes, posed = rows.whole, rows.numbers, tree.spans, tree.nodes, tree.posed
    laws, kinds, ends = field.numbers, field.whole, tree.nodes.ends
    for row in range(rows.used[0]):
        pair = whole[row, PAIR]
        below = laws[pair, VIOLATED_BELOW]
        if whole[row, STAGE] == HALVED or numbers[row, CLEAR] >= below:
            continue
        span, body = whole[row, SPAN_OF], kinds[pair, BODY]
        for side in range(2):
            key = spans[span, LOW] if side == 0 else spans[span, HIGH]
            if key not in (0, GRID):
                continue
            at = spans[span, AT_LOW] if side == 0 else spans[span, AT_HIGH]
            if not posed[at]:
                stand(tree, way, at)
            place(nodes, at, way.arm, body)
            gap = core_gap(ends, at, body, laws, pair, kinds[pair, SHAPE])[0] - laws[pair, RADII]
            if gap < below:
                note(violated, kinds[pair, KIND], 0.0, gap, 0.0, key, pair)


@lent
def leaf_count(rows: SearchRows) -> int:
    """Number of rows that were not halved."""
    whole, count = rows.whole, 0
    for row in range(rows.used[0]):
        count += whole[row, STAGE] != HALVED
    return count


@lent
def leaves_of(tree: Tree, rows: SearchRows, leaves: Floats, since: int) -> float:
    """Writes the rows that were not halved to `leaves` from `since` on; their highest index."""
    whole, numbers, spans, upper, at = rows.whole, rows.numbers, tree.spans, 0.0, since
    for row in range(rows.used[0]):
        if whole[row, STAGE] != HALVED:
            span = whole[row, SPAN_OF]
            leaves[at, LEAF_LOW], leaves[at, LEAF_HIGH] = spans[span, LOW], spans[span, HIGH]
            leaves[at, LEAF_PAIR] = whole[row, PAIR]
            for column in range(LEAF - LEAF_NUMBERS):
                leaves[at, LEAF_NUMBERS + column] = numbers[row, column]
            upper = max(upper, numbers[row, BOUND])
            at += 1
    return upper


@compiled
def searched(
    tree: Tree,
    rows: SearchRows,
    heap: Heap,
    way: StraightPath,
    table: Floats,
    field: Field,
    pairs: Whole,
    profile: Floats,
    law: Floats,
    floor: float,
    looks: int,
    met: Met,
    far: Whole,
) -> tuple[Tree, SearchRows, Heap, int, float]:
    """Rows of these pairs on this path, settled; there is room for those of the first cut.

    `far` gets, for each pair, the spans of the first cut that have no row, as bits.

    Returns:
        The tree, rows and heap, the status, and the highest index that was met.
    """
    plant(tree, way, profile)
    first_rows(tree, way, table, field, pairs, law, rows, far)
    heaped(heap.key, heap.row, heap.used, rows.numbers[: rows.used[0], BOUND])
    best, status = floor, ANSWERED
    while True:
        finished, best = explored(
            tree, way, table, field, rows, heap, profile, law, met, best, math.inf, FIRST_LEVEL + DEPTH, looks
        )
        if finished:
            _at_rest(tree, way, field, rows, met.violated)
            if _any_hides(rows, field, met.violated):
                status = HIDDEN
            break
        if rows.used[0] > ROWS_MOST:
            status = TOO_MANY
            break
        tree, rows = trees.with_room(tree), with_room(rows, rows.used[0] + 2)
        heap = heaps.with_room(heap, heap.used[0] + 2)
    return tree, rows, heap, status, best

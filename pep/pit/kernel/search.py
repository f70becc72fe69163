"""Branch and bound on the index of a whole path, compiled: what `pep.pit.certify` proves, the most doubtful row first.

A row is a pair on a span of the path. At first all that is known of it is how far apart the balls around both cores
are; most rows are settled by that. What may still raise the answer is looked at closer, the highest bound first: the
distance in the middle, then what the nodes at both ends prove, then both halves. Once the highest bound is settled, all
are.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.pit.certify import DEPTH, ROWS_MOST, VIOLATION_RESOLUTION_M
from pep.pit.kernel import heap as heaps
from pep.pit.kernel import tree as trees
from pep.pit.kernel.arm import place, place_all, put
from pep.pit.kernel.columns import (
    AROUND,
    BODY,
    CENTER,
    GROUP,
    KIND,
    PLANE,
    RADII,
    SHAPE,
    VIOLATED_BELOW,
)
from pep.pit.kernel.compiled import compiled, lent
from pep.pit.kernel.gap import core_gap, interval_gap, plane_gap
from pep.pit.kernel.heap import heaped, lower, pop, push
from pep.pit.kernel.known import (
    ANSWERED,
    AWAY,
    BALLS,
    BOUND,
    CLEAR,
    CLEAR_MID,
    FINAL,
    HALF,
    HALVED,
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
    rough,
    settled,
    with_room,
)
from pep.pit.kernel.law import calm_beyond, pair_index
from pep.pit.kernel.rows import ball_gap
from pep.pit.kernel.tree import (
    AT_HIGH,
    AT_LOW,
    AT_MID,
    HIGH,
    HIGHEST_RATE,
    LEFT,
    LEVEL,
    LOW,
    MIDDLE_RATE,
    SPANS,
    WHOLE_LEAF,
    halve,
    is_full,
    plant,
    stand,
)
from pep.pit.path import CHORD, GRID
from pep.pit.tier import MOVING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.heap import Heap
    from pep.pit.kernel.known import Met, Rows
    from pep.pit.kernel.rows import Field, Way
    from pep.pit.kernel.tree import Tree
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]

NOT_LOOKED: Final = -1


@compiled
def _first_rows(
    tree: Tree, way: Way, table: Floats, field: Field, pairs: Whole, law: Floats, rows: Rows, heap: Heap
) -> Any:
    """The first spans' rows, but for those far apart: shape (spans, pairs), which of them are."""
    count, numbers, whole = pairs.shape[0], field.numbers, field.whole
    spans, rates, ends, speeds = tree.spans, tree.rates, tree.nodes.ends, tree.nodes.speed
    swerves, spins = tree.nodes.swerve, tree.nodes.spin
    bodies, first = table.shape[0], tree.counts[SPANS]
    # Per pair, side by side: the obstacle's centre, how far from there the body's own centre must be, that nothing
    # counts more than any motion and no violation can hide, and how much farther per m/s. Planes have no centre.
    about, body_of, moved = np.empty((count, 5)), np.empty(count, np.int64), np.zeros(bodies, np.bool_)
    for each in range(count):
        pair = pairs[each]
        body, kind = whole[pair, BODY], whole[pair, KIND]
        body_of[each], moved[body] = body, True
        calm = calm_beyond(kind, numbers, pair, 0.0, law)
        about[each, 0], about[each, 1] = numbers[pair, CENTER], numbers[pair, CENTER + 1]
        about[each, 2] = numbers[pair, CENTER + 2]
        apart = max(calm, numbers[pair, VIOLATED_BELOW]) + table[body, HALF] + numbers[pair, AROUND]
        about[each, 3] = math.inf if whole[pair, SHAPE] == PLANE else apart + numbers[pair, RADII]
        about[each, 4] = calm_beyond(kind, numbers, pair, 1.0, law) - calm
    # Per body: its centre, how far it strays from there, its speed, and that per unit of ds/dt.
    moving, placed = np.flatnonzero(moved), np.empty((bodies, 6))
    far, near = np.empty((first, count), np.bool_), np.empty(count + 1, np.int64)
    row_whole, row_numbers, doubts = rows.whole, rows.numbers, rows.doubts
    used = doubtful = 0
    for k in range(first):
        at, width = spans[k, AT_MID], (spans[k, HIGH] - spans[k, LOW]) / GRID
        place_all(tree.nodes, at, way.arm, moving)
        for each in range(moving.shape[0]):
            body = moving[each]
            for i in range(3):
                placed[body, i] = 0.5 * (ends[at, body, 0, i] + ends[at, body, 1, i])
            placed[body, 3], placed[body, 5] = rough(
                speeds[at, body], swerves[at, body], spins[at, body], table, body, width
            )
            placed[body, 4] = placed[body, 5] * rates[k, HIGHEST_RATE]
        # The tight loop of the whole engine: no branch, no root, nothing written but where it is needed.
        found = 0
        for each in range(count):
            body = body_of[each]
            x, y = placed[body, 0] - about[each, 0], placed[body, 1] - about[each, 1]
            z, apart = placed[body, 2] - about[each, 2], about[each, 3] + placed[body, 3]
            apart += about[each, 4] * placed[body, 4]
            is_far = (apart >= 0.0) & (x * x + y * y + z * z >= apart * apart)
            far[k, each], near[found] = is_far, each
            found += not is_far
        for each in near[:found]:
            body, pair = body_of[each], pairs[each]
            kind, below, strays, speed = (
                whole[pair, KIND],
                numbers[pair, VIOLATED_BELOW],
                placed[body, 3],
                placed[body, 4],
            )
            if whole[pair, SHAPE] == PLANE:
                clear = plane_gap(ends, at, body, numbers, pair)[0] - numbers[pair, RADII] - strays
                if clear >= max(calm_beyond(kind, numbers, pair, speed, law), below):
                    far[k, each] = True
                    continue
            else:
                x, y = placed[body, 0] - about[each, 0], placed[body, 1] - about[each, 1]
                z = placed[body, 2] - about[each, 2]
                clear = math.sqrt(x * x + y * y + z * z) - strays
                clear -= table[body, HALF] + numbers[pair, AROUND] + numbers[pair, RADII]
            row_whole[used, SPAN_OF], row_whole[used, PAIR], row_whole[used, STAGE] = k, pair, BALLS
            row_numbers[used, CLEAR], row_numbers[used, RUSH] = clear, placed[body, 5]
            row_numbers[used, CLEAR_MID], row_numbers[used, RUSH_MID] = math.inf, 0.0
            row_numbers[used, STRAYS] = strays
            row_numbers[used, BOUND] = pair_index(kind, numbers, pair, clear, speed, law)
            if clear < below:
                doubts[doubtful] = used
                doubtful += 1
            used += 1
    rows.used[0], rows.used[1] = used, doubtful
    heaped(heap.key, heap.row, heap.used, row_numbers[:used, BOUND])
    return far


@lent
def explored(
    tree: Tree,
    way: Way,
    table: Floats,
    field: Field,
    rows: Rows,
    heap: Heap,
    profile: Floats,
    law: Floats,
    met: Met,
    best: float,
    ceiling: float,
    deepest: int,
    looks: int,
) -> tuple[bool, float]:
    """Whether all rows are settled, or more room is needed; and the highest index that was met.

    One function, however long: whatever is called with arrays counts a reference to each, and these calls would cost
    more than all the rest.

    Args:
        best: a known index, above which the answer is sought.
        ceiling: once a higher one is met, nothing more is looked for.
        deepest: the level of spans that are not halved.
        looks: how often each group that does not decide the answer is looked at where it would raise it most.
    """
    whole, numbers, doubts, used = rows.whole, rows.numbers, rows.doubts, rows.used
    keys, key_rows, key_count = heap.key, heap.row, heap.used
    nodes, arm, spans, rates, posed = tree.nodes, way.arm, tree.spans, tree.rates, tree.posed
    frames, turning, ends, speeds, swerves = nodes.frames, nodes.turning, nodes.ends, nodes.speed, nodes.swerve
    spins, known, link, reference, own, half = nodes.spin, nodes.known, arm.link, arm.reference, arm.ends, arm.half
    laws, kinds = field.numbers, field.whole
    witnesses, violated, top, knots = met.witnesses, met.violated, met.top, met.knots
    look, on_top = NOT_LOOKED, False
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
        if stage == BALLS:
            # 2. The distance in the middle. Less what levers allow, it often settles the row.
            gap, x, y, z = core_gap(ends, middle, body, laws, pair, shape, knots)
            clear, rush = gap - laws[pair, RADII], speeds[middle, body] + table[body, RADIUS] * spins[middle, body]
            numbers[row, CLEAR_MID], numbers[row, RUSH_MID] = clear, rush
            numbers[row, CLEAR] = clear - numbers[row, STRAYS]
            numbers[row, AWAY], numbers[row, AWAY + 1], numbers[row, AWAY + 2] = x, y, z
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
            first, last = spans[span, AT_LOW], spans[span, AT_HIGH]
            for side in range(2):
                at = first if side == 0 else last
                if not posed[at]:
                    stand(tree, way, at)
                if not known[at, body]:
                    put(frames, turning, ends, speeds, swerves, spins, known, link, reference, own, at, body)
            width = (spans[span, HIGH] - spans[span, LOW]) / GRID
            bend = width * width / CHORD
            gaps = (0.0, numbers[row, AWAY], numbers[row, AWAY + 1], numbers[row, AWAY + 2])
            sag = table[body, SECOND] * bend
            numbers[row, CLEAR] = interval_gap(ends, first, middle, last, body, laws, pair, shape, gaps, sag)
            speed = max(speeds[first, body], speeds[middle, body], speeds[last, body]) + table[body, THIRD] * bend
            spin = max(spins[first, body], spins[middle, body], spins[last, body]) + table[body, SPIN_SECOND] * bend
            numbers[row, RUSH] = speed + table[body, RADIUS] * spin
            whole[row, STAGE] = NODES
        elif spans[span, LEVEL] >= deepest:
            whole[row, STAGE] = FINAL
            continue
        else:
            # 4. Both halves, each known by its balls.
            if spans[span, LEFT] == WHOLE_LEAF and is_full(tree):
                if not on_top:
                    used[1] += 1
                return False, best
            if on_top:
                pop(keys, key_rows, key_count)
            left, width = halve(tree, way, profile, span), 0.5 * (spans[span, HIGH] - spans[span, LOW]) / GRID
            for side in range(2):
                span, new = left + side, used[0]
                used[0] = new + 1
                middle = spans[span, AT_MID]
                if not known[middle, body]:
                    put(frames, turning, ends, speeds, swerves, spins, known, link, reference, own, middle, body)
                if shape == PLANE:
                    clear = plane_gap(ends, middle, body, laws, pair)[0] - laws[pair, RADII]
                else:
                    clear = ball_gap(ends, middle, body, half, laws, pair)
                strays, rush = rough(
                    speeds[middle, body], swerves[middle, body], spins[middle, body], table, body, width
                )
                bound = pair_index(kind, laws, pair, clear - strays, rush * rates[span, HIGHEST_RATE], law)
                whole[new, SPAN_OF], whole[new, PAIR], whole[new, STAGE] = span, pair, BALLS
                numbers[new, CLEAR], numbers[new, RUSH], numbers[new, STRAYS] = clear - strays, rush, strays
                numbers[new, CLEAR_MID], numbers[new, RUSH_MID], numbers[new, BOUND] = math.inf, 0.0, bound
                if not settled(bound, best):
                    push(keys, key_rows, key_count, bound, new)
                if clear - strays < below and violated[kind, MET_PAIR] == NOBODY:
                    doubts[used[1]] = new
                    used[1] += 1
            whole[row, STAGE] = HALVED
            continue
        bound = pair_index(kind, laws, pair, numbers[row, CLEAR], numbers[row, RUSH] * rates[span, HIGHEST_RATE], law)
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
    """Whether the row may hide a violation of a kind that was not met yet."""
    pair = whole[row, PAIR]
    short = VIOLATION_RESOLUTION_M if whole[row, STAGE] >= NODES else 0.0
    if numbers[row, CLEAR] >= laws[pair, VIOLATED_BELOW] - short:
        return False
    return violated[kinds[pair, KIND], MET_PAIR] == NOBODY


@lent
def _tops(whole: Whole, numbers: Floats, kinds: Whole, top: Whole, count: int, looks: int) -> None:
    """Per group the rows that may raise it most, of those of which no distance is known; -1 where there are no more."""
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
def _at_rest(tree: Tree, way: Way, field: Field, rows: Rows, violated: Floats, knots: Floats) -> None:
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
            gap = core_gap(ends, at, body, laws, pair, kinds[pair, SHAPE], knots)[0] - laws[pair, RADII]
            if gap < below:
                note(violated, kinds[pair, KIND], 0.0, gap, 0.0, key, pair)


@compiled
def leaves_of(tree: Tree, rows: Rows) -> tuple[Floats, float]:
    """The rows that were not halved, and the highest index of those."""
    whole, numbers, spans, count = rows.whole, rows.numbers, tree.spans, 0
    used, upper, done = rows.used[0], 0.0, 0
    for row in range(used):
        count += whole[row, STAGE] != HALVED
    leaves = np.empty((LEAF, count))
    for row in range(used):
        if whole[row, STAGE] != HALVED:
            span = whole[row, SPAN_OF]
            leaves[LEAF_LOW, done], leaves[LEAF_HIGH, done] = spans[span, LOW], spans[span, HIGH]
            leaves[LEAF_PAIR, done] = whole[row, PAIR]
            for column in range(LEAF - LEAF_NUMBERS):
                leaves[LEAF_NUMBERS + column, done] = numbers[row, column]
            upper = max(upper, numbers[row, BOUND])
            done += 1
    return leaves, upper


@compiled
def searched(
    tree: Tree,
    rows: Rows,
    heap: Heap,
    way: Way,
    table: Floats,
    field: Field,
    pairs: Whole,
    profile: Floats,
    law: Floats,
    floor: float,
    first: int,
    looks: int,
    met: Met,
) -> tuple[Tree, Rows, Heap, Any, int, float]:
    """The rows of these pairs on this path, settled; there is room for those of the first cut.

    Returns:
        The tree, rows and heap, which of the first cut's rows (spans, pairs) are far apart and no rows, the status,
        and the highest index that was met.
    """
    level = 0
    while 1 << level < first:
        level += 1
    plant(tree, way, profile, first, level)
    far = _first_rows(tree, way, table, field, pairs, law, rows, heap)
    best, status = floor, ANSWERED
    while True:
        finished, best = explored(
            tree, way, table, field, rows, heap, profile, law, met, best, math.inf, level + DEPTH, looks
        )
        if finished:
            _at_rest(tree, way, field, rows, met.violated, met.knots)
            break
        if rows.used[0] > ROWS_MOST:
            status = TOO_MANY
            break
        tree, rows = trees.with_room(tree), with_room(rows, rows.used[0] + 2)
        heap = heaps.with_room(heap, heap.used[0] + 2)
    return tree, rows, heap, far, status, best

"""Branch and bound on the index of a whole path, compiled: what `pep.pit.certify` proves, the most doubtful row first.

A row is a pair on a span of the path. At first all that is known of it is how far apart the balls around both cores
are; most rows are settled by that. What may still raise the answer is looked at closer, the highest bound first: the
distance in the middle, then what the nodes at both ends prove, then both halves. Once the highest bound is settled, all
are.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

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
from pep.pit.kernel.compiled import compiled, entry
from pep.pit.kernel.gap import core_gap, interval_gap
from pep.pit.kernel.heap import heaped, no_heap, pop, push
from pep.pit.kernel.known import (
    ANSWERED,
    BALLS,
    BOUND,
    CLEAR,
    CLEAR_MID,
    FINAL,
    GAP,
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
    Met,
    Rows,
    no_rows,
    note,
    rough,
    settled,
    with_room,
)
from pep.pit.kernel.law import calm_beyond, highest_rate, pair_index, rate_at
from pep.pit.kernel.rows import Way, ball_gap
from pep.pit.kernel.tree import (
    AT_HIGH,
    AT_LOW,
    AT_MID,
    HIGH,
    LEFT,
    LEVEL,
    LOW,
    SPANS,
    WHOLE_LEAF,
    halve,
    is_full,
    no_tree,
    plant,
)
from pep.pit.path import CHORD, GRID
from pep.pit.tier import HIGHEST, MOVING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.heap import Heap
    from pep.pit.kernel.rows import Field
    from pep.pit.kernel.tree import Tree
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]


@compiled
def _first_rows(
    tree: Tree,
    way: Way,
    table: Floats,
    field: Field,
    pairs: Whole,
    profile: Floats,
    law: Floats,
    rows: Rows,
    heap: Heap,
    leaves: Floats,
    knots: Floats,
) -> int:
    """The first spans' rows; those far apart are leaves, as many as is returned.

    The tight loop of the whole engine: plain numbers, no views.
    """
    count, numbers, whole = pairs.shape[0], field.numbers, field.whole
    spans, ends, speeds, spins = tree.spans, tree.nodes.ends, tree.nodes.speed, tree.nodes.spin
    bodies = table.shape[0]
    # Per pair, side by side: the obstacle's centre, what the balls' radii sum up to, the clearance from which on it
    # counts no more than any motion, at no speed and per m/s, and below which it is a violation.
    rows_of, moved = np.empty((count, 7)), np.zeros(bodies, np.bool_)
    body_of, plane = np.empty(count, np.int64), np.empty(count, np.bool_)
    for each in range(count):
        pair = pairs[each]
        body, kind = whole[pair, BODY], whole[pair, KIND]
        moved[body] = True
        body_of[each], plane[each] = body, whole[pair, SHAPE] == PLANE
        for i in range(3):
            rows_of[each, i] = numbers[pair, CENTER + i]
        rows_of[each, 3] = table[body, HALF] + numbers[pair, AROUND] + numbers[pair, RADII]
        rows_of[each, 4] = calm_beyond(kind, numbers, pair, 0.0, law)
        rows_of[each, 5] = calm_beyond(kind, numbers, pair, 1.0, law) - rows_of[each, 4]
        rows_of[each, 6] = numbers[pair, VIOLATED_BELOW]
    moving, centers = np.flatnonzero(moved), np.empty((bodies, 3))
    strays, rush = np.empty(bodies), np.empty(bodies)
    row_whole, row_numbers, doubts = rows.whole, rows.numbers, rows.doubts
    done = used = doubtful = 0
    for k in range(tree.counts[SPANS]):
        at, low, high = spans[k, AT_MID], spans[k, LOW], spans[k, HIGH]
        width, rate = (high - low) / GRID, highest_rate(low / GRID, high / GRID, profile)
        place_all(tree.nodes, at, way.arm, moving)
        for each in range(moving.shape[0]):
            body = moving[each]
            for i in range(3):
                centers[body, i] = 0.5 * (ends[at, body, 0, i] + ends[at, body, 1, i])
            strays[body], rush[body] = rough(speeds[at, body], spins[at, body], table, body, width)
        for each in range(count):
            body, pair = body_of[each], pairs[each]
            speed, below = rush[body] * rate, rows_of[each, 6]
            enough = max(rows_of[each, 4] + rows_of[each, 5] * speed, below)
            if not plane[each]:
                x, y = centers[body, 0] - rows_of[each, 0], centers[body, 1] - rows_of[each, 1]
                z, around = centers[body, 2] - rows_of[each, 2], rows_of[each, 3] + strays[body]
                square, far = x * x + y * y + z * z, enough + around
                near = not (far >= 0.0 and square >= far * far)
                clear = math.sqrt(square) - around if near else enough
            else:
                clear = core_gap(ends, at, body, numbers, pair, PLANE, knots)[0] - numbers[pair, RADII] - strays[body]
                near = not clear >= enough
            if not near:
                leaves[LEAF_LOW, done], leaves[LEAF_HIGH, done], leaves[LEAF_PAIR, done] = low, high, pair
                leaves[LEAF_NUMBERS, done], leaves[LEAF_NUMBERS + 1, done] = clear, rush[body]
                leaves[LEAF_NUMBERS + 2, done], leaves[LEAF_NUMBERS + 3, done] = math.inf, 0.0
                leaves[LEAF_NUMBERS + 4, done] = MOVING
                done += 1
                continue
            row_whole[used, SPAN_OF], row_whole[used, PAIR], row_whole[used, STAGE] = k, pair, BALLS
            row_numbers[used, CLEAR], row_numbers[used, RUSH] = clear, rush[body]
            row_numbers[used, CLEAR_MID], row_numbers[used, RUSH_MID] = math.inf, 0.0
            row_numbers[used, STRAYS] = strays[body]
            row_numbers[used, BOUND] = pair_index(whole[pair, KIND], numbers, pair, clear, speed, law)
            if clear < below:
                doubts[doubtful] = used
                doubtful += 1
            used += 1
    rows.used[0], rows.used[1] = used, doubtful
    heaped(heap.key, heap.row, heap.used, row_numbers[:used, BOUND])
    return done


@compiled
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
    nodes, arm, spans = tree.nodes, way.arm, tree.spans
    frames, turning, ends, speeds = nodes.frames, nodes.turning, nodes.ends, nodes.speed
    spins, known, link, reference, own, half = nodes.spin, nodes.known, arm.link, arm.reference, arm.ends, arm.half
    laws, kinds = field.numbers, field.whole
    witnesses, violated, top, knots = met.witnesses, met.violated, met.top, met.knots
    row, looked, group = -1, 0, 0
    while True:
        # 1. Which row: the one with the highest bound, or one that may hide a violation, or one that tells of a group.
        if used[0] + 2 > whole.shape[0] or key_count[0] + 4 > keys.shape[0]:
            return False, best
        for_sight = False
        if key_count[0] > 0 and not settled(keys[0], best):
            row = key_rows[0]
            pop(keys, key_rows, key_count)
            if whole[row, STAGE] >= FINAL or settled(numbers[row, BOUND], best):  # looked at since, in doubt
                continue
        elif used[1] > 0:
            used[1] -= 1
            row = doubts[used[1]]
            if whole[row, STAGE] >= FINAL or not _hides(row, whole, numbers, laws, kinds, violated):
                continue
        elif looked < looks:
            if group == 0:
                _tops(whole, numbers, kinds, witnesses, top, used[0])
            row, for_sight = top[group], True
            group += 1
            if group == top.shape[0]:
                looked, group = looked + 1, 0
            if row < 0 or whole[row, STAGE] != BALLS:
                continue
        else:
            return True, best
        span, pair, stage = whole[row, SPAN_OF], whole[row, PAIR], whole[row, STAGE]
        low, high, middle = spans[span, LOW], spans[span, HIGH], spans[span, AT_MID]
        body, shape, kind, below = kinds[pair, BODY], kinds[pair, SHAPE], kinds[pair, KIND], laws[pair, VIOLATED_BELOW]
        if stage == BALLS:
            # 2. The distance in the middle. Less what levers allow, it often settles the row.
            gap = core_gap(ends, middle, body, laws, pair, shape, knots)
            numbers[row, GAP], numbers[row, GAP + 1], numbers[row, GAP + 2], numbers[row, GAP + 3] = gap
            clear, rush = gap[0] - laws[pair, RADII], speeds[middle, body] + table[body, RADIUS] * spins[middle, body]
            numbers[row, CLEAR_MID], numbers[row, RUSH_MID] = clear, rush
            key = (low + high) // 2
            speed = rush * rate_at(key / GRID, profile)
            index = pair_index(kind, laws, pair, clear, speed, law)
            best = max(best, index)
            if best > ceiling:
                return True, best
            note(witnesses, kinds[pair, GROUP], index, clear, speed, key, pair)
            if clear < below:
                note(violated, kind, 0.0, clear, speed, key, pair)
            numbers[row, CLEAR] = clear - numbers[row, STRAYS]
            whole[row, STAGE] = MIDDLE
        elif stage == MIDDLE:
            # 3. What the nodes at both ends prove.
            first, last = spans[span, AT_LOW], spans[span, AT_HIGH]
            if not known[first, body]:
                put(frames, turning, ends, speeds, spins, known, link, reference, own, first, body)
            if not known[last, body]:
                put(frames, turning, ends, speeds, spins, known, link, reference, own, last, body)
            width = (high - low) / GRID
            bend = width * width / CHORD
            gap = (numbers[row, GAP], numbers[row, GAP + 1], numbers[row, GAP + 2], numbers[row, GAP + 3])
            sag = table[body, SECOND] * bend
            numbers[row, CLEAR] = interval_gap(ends, first, middle, last, body, laws, pair, shape, gap, sag)
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
                push(keys, key_rows, key_count, HIGHEST, row)
                return False, best
            left, width = halve(tree, way, span), 0.5 * (high - low) / GRID
            for side in range(2):
                span, new = left + side, used[0]
                used[0] = new + 1
                middle = spans[span, AT_MID]
                if not known[middle, body]:
                    put(frames, turning, ends, speeds, spins, known, link, reference, own, middle, body)
                if shape == PLANE:
                    clear = core_gap(ends, middle, body, laws, pair, PLANE, knots)[0] - laws[pair, RADII]
                else:
                    clear = ball_gap(ends, middle, body, half, laws, pair)
                strays, rush = rough(speeds[middle, body], spins[middle, body], table, body, width)
                rate = highest_rate(spans[span, LOW] / GRID, spans[span, HIGH] / GRID, profile)
                bound = pair_index(kind, laws, pair, clear - strays, rush * rate, law)
                whole[new, SPAN_OF], whole[new, PAIR], whole[new, STAGE] = span, pair, BALLS
                numbers[new, CLEAR], numbers[new, RUSH], numbers[new, STRAYS] = clear - strays, rush, strays
                numbers[new, CLEAR_MID], numbers[new, RUSH_MID], numbers[new, BOUND] = math.inf, 0.0, bound
                push(keys, key_rows, key_count, bound, new)
                if clear - strays < below and violated[kind, MET_PAIR] == NOBODY:
                    doubts[used[1]] = new
                    used[1] += 1
            whole[row, STAGE] = HALVED
            continue
        rate = highest_rate(low / GRID, high / GRID, profile)
        numbers[row, BOUND] = pair_index(kind, laws, pair, numbers[row, CLEAR], numbers[row, RUSH] * rate, law)
        if for_sight:  # it is in the heap as it was, and settled
            continue
        push(keys, key_rows, key_count, numbers[row, BOUND], row)
        if numbers[row, CLEAR] < below and violated[kind, MET_PAIR] == NOBODY:
            doubts[used[1]] = row
            used[1] += 1


@compiled
def _hides(row: int, whole: Whole, numbers: Floats, laws: Floats, kinds: Whole, violated: Floats) -> bool:
    """Whether the row may hide a violation of a kind that was not met yet."""
    pair = whole[row, PAIR]
    short = VIOLATION_RESOLUTION_M if whole[row, STAGE] >= NODES else 0.0
    if numbers[row, CLEAR] >= laws[pair, VIOLATED_BELOW] - short:
        return False
    return violated[kinds[pair, KIND], MET_PAIR] == NOBODY


@compiled
def _tops(whole: Whole, numbers: Floats, kinds: Whole, witnesses: Floats, top: Whole, count: int) -> None:
    """Per group the row that may raise what it was met at most, of those of which no distance is known; -1 for none."""
    top[:] = -1
    for row in range(count):
        if whole[row, STAGE] == BALLS:
            group, bound = kinds[whole[row, PAIR], GROUP], numbers[row, BOUND]
            if bound <= max(MOVING, witnesses[group, MET_INDEX]):
                continue
            other = top[group]
            if other >= 0:
                theirs = numbers[other, BOUND]
                if bound < theirs or (bound == theirs and numbers[row, CLEAR] >= numbers[other, CLEAR]):
                    continue
            top[group] = row


@compiled
def _at_rest(tree: Tree, way: Way, field: Field, rows: Rows, violated: Floats, knots: Floats) -> None:
    """Violations at both ends of the path, where the arm stands and no middle ever lies."""
    whole, spans, nodes = rows.whole, tree.spans, tree.nodes
    for row in range(rows.used[0]):
        pair = whole[row, PAIR]
        below = field.numbers[pair, VIOLATED_BELOW]
        if whole[row, STAGE] == HALVED or rows.numbers[row, CLEAR] >= below:
            continue
        span, body = whole[row, SPAN_OF], field.whole[pair, BODY]
        for side in range(2):
            key = spans[span, LOW] if side == 0 else spans[span, HIGH]
            if key not in (0, GRID):
                continue
            at = spans[span, AT_LOW] if side == 0 else spans[span, AT_HIGH]
            place(nodes, at, way.arm, body)
            gap = core_gap(nodes.ends, at, body, field.numbers, pair, field.whole[pair, SHAPE], knots)[0]
            if gap - field.numbers[pair, RADII] < below:
                note(violated, field.whole[pair, KIND], 0.0, gap - field.numbers[pair, RADII], 0.0, key, pair)


@compiled
def all_leaves(tree: Tree, rows: Rows, far: Floats, done: int) -> tuple[Floats, float]:
    """The first `done` leaves and the rows that were not halved, and the highest index of those."""
    whole, numbers, spans = rows.whole, rows.numbers, tree.spans
    count = done
    for row in range(rows.used[0]):
        count += whole[row, STAGE] != HALVED
    leaves = np.empty((LEAF, count))
    for column in range(LEAF):
        leaves[column, :done] = far[column, :done]
    upper = 0.0
    for row in range(rows.used[0]):
        if whole[row, STAGE] != HALVED:
            span = whole[row, SPAN_OF]
            leaves[LEAF_LOW, done], leaves[LEAF_HIGH, done] = spans[span, LOW], spans[span, HIGH]
            leaves[LEAF_PAIR, done] = whole[row, PAIR]
            for column in range(LEAF - LEAF_NUMBERS):
                leaves[LEAF_NUMBERS + column, done] = numbers[row, column]
            upper = max(upper, numbers[row, BOUND])
            done += 1
    return leaves, upper


class Room(NamedTuple):
    """What a search works in: kept from one to the next, since fresh memory costs more than the search."""

    tree: Tree
    rows: Rows
    heap: Heap
    leaves: Floats


@entry
def room_for(bodies: int, joints: int, rows: int) -> Room:
    """Room for so many rows of an arm with so many bodies and joints."""
    return Room(no_tree(bodies, joints), no_rows(rows), no_heap(rows), np.empty((LEAF, rows)))


@compiled
def searched(
    room: Room,
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
) -> tuple[Room, int, int, float]:
    """The rows of these pairs on this path, settled; there is room for those of the first cut.

    Returns:
        The room that was needed, the status, how many of its leaves are in use, and the highest index that was met.
    """
    level = 0
    while 1 << level < first:
        level += 1
    tree, rows, heap, leaves = room.tree, room.rows, room.heap, room.leaves
    plant(tree, way, first, level)
    done = _first_rows(tree, way, table, field, pairs, profile, law, rows, heap, leaves, met.knots)
    best = floor
    while True:
        finished, best = explored(
            tree, way, table, field, rows, heap, profile, law, met, best, math.inf, level + DEPTH, looks
        )
        if finished:
            break
        if rows.used[0] > ROWS_MOST:
            return Room(tree, rows, heap, leaves), TOO_MANY, done, best
        tree, rows = trees.with_room(tree), with_room(rows, rows.used[0] + 2)
        heap = heaps.with_room(heap, heap.used[0] + 4)
    _at_rest(tree, way, field, rows, met.violated, met.knots)
    return Room(tree, rows, heap, leaves), ANSWERED, done, best

"""Rows of (interval, pair) on a course: what is proven there, what is met, and the halving of what is not settled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.certify import LOWER_DEPTH
from pep.pit.kernel.arm import place
from pep.pit.kernel.bending import (
    BENDS,
    HURRY,
    SPIN_HURRY,
    STRAY,
    rough_rush,
    rough_stray,
    rush_on,
    sag_on,
    worst_on,
)
from pep.pit.kernel.columns import BODY, KIND, PLANE, RADII, SHAPE
from pep.pit.kernel.compiled import compiled, entry
from pep.pit.kernel.curve import row_of, with_interval, with_key
from pep.pit.kernel.gap import KNOTS, core_gap, interval_gap
from pep.pit.kernel.law import blow_of, highest_rate, pair_index, rate_at
from pep.pit.kernel.rows import ball_gap
from pep.pit.path import GRID
from pep.pit.tier import TIE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Nodes
    from pep.pit.kernel.curve import Curve, Known
    from pep.pit.kernel.rows import Field
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]

# Columns of a row's whole numbers, and of its others.
LOW: Final = 0
HIGH: Final = 1
PAIR: Final = 2
WHOLES: Final = 3
CLEAR: Final = 0
RUSH: Final = 1
CLEAR_MID: Final = 2
RUSH_MID: Final = 3
BOUND: Final = 4
NUMBERS: Final = 5


class Rows(NamedTuple):
    """Rows as `pep.pit.path.Leaves` has them, and the index proven on each: (n, WHOLES) and (n, NUMBERS)."""

    whole: Whole
    numbers: Floats


@compiled
def room_for(count: int) -> Rows:
    """Room for so many rows."""
    return Rows(np.empty((count, WHOLES), np.int64), np.empty((count, NUMBERS)))


@compiled
def with_room(rows: Rows, used: int, count: int) -> Rows:
    """The first `used` rows, with room for so many more."""
    if used + count <= rows.whole.shape[0]:
        return rows
    wide = room_for(used + max(used, count))
    wide.whole[:used], wide.numbers[:used] = rows.whole[:used], rows.numbers[:used]
    return wide


@compiled
def copied(rows: Rows, used: int) -> Rows:
    """The first `used` rows alone."""
    return Rows(rows.whole[:used].copy(), rows.numbers[:used].copy())


@compiled
def met_near(gap: float, shape: int, stray: float) -> float:
    """What the arm may meet beside the course counts as met: the gap would not close however short the interval."""
    near = gap - stray
    return near if shape == PLANE else max(near, 0.0)


@compiled
def rush_met(nodes: Nodes, at: int, body: int, radius: float, worst: Floats) -> float:
    """Surface speed per unit of ds/dt that the body may have at this configuration."""
    speed, spin = nodes.speed[at, body] + worst[HURRY, body], nodes.spin[at, body] + worst[SPIN_HURRY, body]
    return speed + radius * spin


@compiled
def proven_rush(
    nodes: Nodes, low: int, mid: int, high: int, body: int, radius: float, worst: Floats, width: float
) -> float:
    """Bound on the body's surface speed per unit of ds/dt on an interval; it is placed at all three nodes."""
    speed = max(nodes.speed[low, body], nodes.speed[mid, body], nodes.speed[high, body])
    spin = max(nodes.spin[low, body], nodes.spin[mid, body], nodes.spin[high, body])
    return rush_on(worst, body, width, speed, spin, radius)


@entry
def examined(known: Known, curve: Curve, field: Field, asked: Whole) -> tuple[Known, Rows]:
    """The rows (LOW, HIGH, PAIR) of `asked` examined, and the configurations known by then."""
    count = asked.shape[0]
    rows, knots, room = room_for(count), np.empty(KNOTS), np.empty((BENDS, curve.arm.link.shape[0]))
    numbers, whole, radius = field.numbers, field.whole, curve.arm.radius
    found = rows.numbers
    rows.whole[:] = asked
    worst, at_low, at_mid, at_high = room, 0, 0, 0
    for row in range(count):
        low, high, pair = asked[row, LOW], asked[row, HIGH], asked[row, PAIR]
        if row == 0 or low != asked[row - 1, LOW] or high != asked[row - 1, HIGH]:
            known = with_interval(known, low, high, curve)
            at_low, at_mid, at_high = row_of(known, low), row_of(known, (low + high) // 2), row_of(known, high)
            worst = worst_on(curve.bends, curve.low, curve.high, low, high, room)
        nodes, body, shape = known.nodes, whole[pair, BODY], whole[pair, SHAPE]
        for at in (at_low, at_mid, at_high):
            if not nodes.known[at, body]:
                place(nodes, at, curve.arm, body)
        width = (high - low) / GRID
        gap = core_gap(nodes.ends, at_mid, body, numbers, pair, shape, knots)
        sag = sag_on(worst, body, width)
        found[row, CLEAR] = interval_gap(nodes.ends, at_low, at_mid, at_high, body, numbers, pair, shape, gap, sag)
        found[row, RUSH] = proven_rush(nodes, at_low, at_mid, at_high, body, radius[body], worst, width)
        found[row, CLEAR_MID] = met_near(gap[0], shape, worst[STRAY, body]) - numbers[pair, RADII]
        found[row, RUSH_MID] = rush_met(nodes, at_mid, body, radius[body], worst)
        found[row, BOUND] = 0.0
    return known, rows


@compiled
def _halves(rows: Rows, which: Whole, count: int) -> Whole:
    """Both halves of those rows' intervals, with their pairs; rows of one interval stay together."""
    halves = np.empty((2 * count, WHOLES), np.int64)
    for to in range(count):
        low, high, pair = rows.whole[which[to], LOW], rows.whole[which[to], HIGH], rows.whole[which[to], PAIR]
        mid = (low + high) // 2
        halves[to, LOW], halves[to, HIGH], halves[to, PAIR] = low, mid, pair
        halves[count + to, LOW], halves[count + to, HIGH], halves[count + to, PAIR] = mid, high, pair
    return halves


@entry
def fits(
    known: Known, curve: Curve, field: Field, leaves: Rows, profile: Floats, law: Floats, index: float
) -> tuple[Known, bool, Rows]:
    """Whether it is proven that no row exceeds `index` (see `pep.pit.certify.fits`), and the rows as far as halved."""
    kept, used = room_for(2 * leaves.whole.shape[0]), 0
    for depth in range(LOWER_DEPTH + 1):
        count = leaves.whole.shape[0]
        kept = with_room(kept, used, count)
        whole, numbers = leaves.whole, leaves.numbers
        over, over_used, begun, hopeless = np.empty(count, np.int64), 0, used, False
        for row in range(count):
            low, high, pair = whole[row, LOW], whole[row, HIGH], whole[row, PAIR]
            kind, rate = field.whole[pair, KIND], highest_rate(low / GRID, high / GRID, profile)
            speed = numbers[row, RUSH] * rate
            if pair_index(kind, field.numbers, pair, numbers[row, CLEAR], speed, law) <= index + TIE:
                kept.whole[used], kept.numbers[used] = whole[row], numbers[row]
                used += 1
                continue
            over[over_used] = row
            over_used += 1
            speed = numbers[row, RUSH_MID] * rate_at((low + high) // 2 / GRID, profile)
            if pair_index(kind, field.numbers, pair, numbers[row, CLEAR_MID], speed, law) > index + TIE:
                hopeless = True
                break
        if over_used == 0 or hopeless or depth == LOWER_DEPTH:
            for row in range(count):  # all of this level, whatever was told of it
                kept.whole[begun + row], kept.numbers[begun + row] = whole[row], numbers[row]
            return known, over_used == 0, copied(kept, begun + count)
        known, leaves = examined(known, curve, field, _halves(leaves, over, over_used))
    return known, False, kept


@entry
def blow(
    known: Known,
    curve: Curve,
    field: Field,
    people: Whole,
    profile: Floats,
    law: Floats,
    first: int,
    depths: int,
    resolution: float,
) -> tuple[Known, float]:
    """Proven highest share of a body region's limit speed on this course (see `pep.pit.blow`)."""
    count = people.shape[0] * first
    asked, used, width = np.empty((count, WHOLES), np.int64), 0, 1.0 / first
    room, arm = np.empty((BENDS, curve.arm.link.shape[0])), curve.arm
    for k in range(first):
        low, high = k * (GRID // first), (k + 1) * (GRID // first)
        known = with_key(known, (low + high) // 2, curve)
        at, worst = row_of(known, (low + high) // 2), worst_on(curve.bends, curve.low, curve.high, low, high, room)
        rate = highest_rate(low / GRID, high / GRID, profile)
        for each in range(people.shape[0]):
            pair = people[each]
            body = field.whole[pair, BODY]
            if not known.nodes.known[at, body]:
                place(known.nodes, at, arm, body)
            gap = ball_gap(known.nodes.ends, at, body, arm.half, field.numbers, pair) - rough_stray(worst, body, width)
            if not blow_of(field.numbers, pair, gap, rough_rush(worst, body, width, arm.radius[body]) * rate, law) <= 0:
                asked[used, LOW], asked[used, HIGH], asked[used, PAIR] = low, high, pair
                used += 1
    asked = asked[:used].copy()
    proven = best = 0.0
    for depth in range(depths + 1):
        known, rows = examined(known, curve, field, asked)
        whole, numbers, count = rows.whole, rows.numbers, rows.whole.shape[0]
        wide, wide_used = np.empty(count, np.int64), 0
        for row in range(count):
            low, high, pair = whole[row, LOW], whole[row, HIGH], whole[row, PAIR]
            speed = numbers[row, RUSH] * highest_rate(low / GRID, high / GRID, profile)
            numbers[row, BOUND] = blow_of(field.numbers, pair, numbers[row, CLEAR], speed, law)
            speed = numbers[row, RUSH_MID] * rate_at((low + high) // 2 / GRID, profile)
            best = max(best, blow_of(field.numbers, pair, numbers[row, CLEAR_MID], speed, law))
        enough = max(proven, best) + resolution
        for row in range(count):
            if depth < depths and numbers[row, BOUND] > enough:
                wide[wide_used] = row
                wide_used += 1
            else:
                proven = max(proven, numbers[row, BOUND])
        if wide_used == 0:
            break
        asked = _halves(rows, wide, wide_used)
    return known, proven


@entry
def rushes(known: Known, curve: Curve, low: Whole, high: Whole) -> tuple[Known, Floats]:
    """Bound on the surface speed per unit of ds/dt of every body on each interval, shape (intervals, bodies).

    Of bodies that are seen from the arm itself it is the rough one: nobody asks how fast the arm passes itself.
    """
    arm = curve.arm
    bodies = arm.link.shape[0]
    found, room = np.empty((low.shape[0], bodies)), np.empty((BENDS, bodies))
    for k in range(low.shape[0]):
        known = with_interval(known, low[k], high[k], curve)
        at_low, at_high = row_of(known, low[k]), row_of(known, high[k])
        at_mid = row_of(known, (low[k] + high[k]) // 2)
        worst = worst_on(curve.bends, curve.low, curve.high, low[k], high[k], room)
        width, nodes = (high[k] - low[k]) / GRID, known.nodes
        for body in range(bodies):
            if arm.reference[body] > 0:
                found[k, body] = rough_rush(worst, body, width, arm.radius[body])
                continue
            for at in (at_low, at_mid, at_high):
                if not nodes.known[at, body]:
                    place(nodes, at, arm, body)
            found[k, body] = proven_rush(nodes, at_low, at_mid, at_high, body, arm.radius[body], worst, width)
    return known, found


@entry
def met_at(known: Known, curve: Curve, field: Field, key: int, pair: Whole) -> tuple[Known, Floats, Floats]:
    """Signed clearance and surface speed per unit of ds/dt of these pairs at one configuration of the course itself."""
    known = with_key(known, key, curve)
    at, nodes, arm = row_of(known, key), known.nodes, curve.arm
    clearance, rush, knots = np.empty(pair.shape[0]), np.empty(pair.shape[0]), np.empty(KNOTS)
    for row in range(pair.shape[0]):
        k = pair[row]
        body = field.whole[k, BODY]
        if not nodes.known[at, body]:
            place(nodes, at, arm, body)
        gap = core_gap(nodes.ends, at, body, field.numbers, k, field.whole[k, SHAPE], knots)
        clearance[row] = gap[0] - field.numbers[k, RADII]
        rush[row] = nodes.speed[at, body] + arm.radius[body] * nodes.spin[at, body]
    return known, clearance, rush

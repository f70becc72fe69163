"""Rows of (interval, pair) on a course: proven bounds, attained values, and halving of open rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.pair_columns import BODY, LIMIT_SPEED, PLANE, RADII, SHAPE
from pep.pit.path.straight_path import GRID
from pep.pit.search.certify import LOWER_DEPTH
from pep.pit.search.kernel.arithmetic.bending import (
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
from pep.pit.search.kernel.arithmetic.body_poses import place, place_all
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.core_distance import core_gap, interval_gap
from pep.pit.search.kernel.arithmetic.course_poses import row_of, rows_of, with_room
from pep.pit.search.kernel.arithmetic.index_law import blow_of, highest_rate, rate_at
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
    WHOLES,
    Rows,
    halves,
    room_for,
    sorted_out,
    with_all,
    with_space,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.course_poses import Curve, CurveConfigurations
    from pep.pit.search.kernel.arithmetic.pair_rows import Field

    Whole = NDArray[np.int64]

# What may be asked of a course, of `answered`.
EXAMINED, FITS, BLOW, RUSHES, MET_AT = range(5)


@compiled
def met_near(gap: float, shape: int, stray: float) -> float:
    """Clearance that the arm may meet beside the course, which counts as met at every width."""
    near = gap - stray
    return near if shape == PLANE else max(near, 0.0)


@compiled
def rush_met(speeds: Floats, spins: Floats, at: int, body: int, radius: float, worst: Floats) -> float:
    """Surface speed per unit of ds/dt that the body may have at this configuration."""
    return speeds[at, body] + worst[HURRY, body] + radius * (spins[at, body] + worst[SPIN_HURRY, body])


@compiled
def proven_rush(
    speeds: Floats, spins: Floats, low: int, mid: int, high: int, body: int, radius: float, worst: Floats, width: float
) -> float:
    """Bound on the body's surface speed per unit of ds/dt on an interval; it is placed at all three nodes."""
    speed = max(speeds[low, body], speeds[mid, body], speeds[high, body])
    spin = max(spins[low, body], spins[mid, body], spins[high, body])
    return rush_on(worst, body, width, speed, spin, radius)


@compiled
def _intervals(asked: Whole) -> int:
    """Number of intervals that these rows have at most."""
    count = 0
    for row in range(asked.shape[0]):
        if row == 0 or asked[row, LOW] != asked[row - 1, LOW] or asked[row, HIGH] != asked[row - 1, HIGH]:
            count += 1
    return count


@compiled
def examined(known: CurveConfigurations, curve: Curve, field: Field, asked: Whole) -> tuple[CurveConfigurations, Rows]:
    """The rows (LOW, HIGH, PAIR) of `asked` examined, and the configurations known by then."""
    count = asked.shape[0]
    rows, room = room_for(count), np.empty((BENDS, curve.arm.link.shape[0]))
    numbers, whole, radius = field.numbers, field.whole, curve.arm.radius
    found = rows.numbers
    copy_into(rows.whole, asked)
    worst, at_low, at_mid, at_high = room, 0, 0, 0
    known = with_room(known, 3 * _intervals(asked))
    nodes, arm = known.nodes, curve.arm
    ends, placed, speeds, spins = nodes.ends, nodes.known, nodes.speed, nodes.spin
    for row in range(count):
        low, high, pair = asked[row, LOW], asked[row, HIGH], asked[row, PAIR]
        if row == 0 or low != asked[row - 1, LOW] or high != asked[row - 1, HIGH]:
            at_low, at_mid, at_high = rows_of(known, low, high, curve)
            worst = worst_on(curve.bends, curve.low, curve.high, low, high, room)
        body, shape = whole[pair, BODY], whole[pair, SHAPE]
        for at in (at_low, at_mid, at_high):
            if not placed[at, body]:
                place(nodes, at, arm, body)
        width = (high - low) / GRID
        gap = core_gap(ends, at_mid, body, numbers, pair, shape)
        sag = sag_on(worst, body, width)
        found[row, CLEAR] = interval_gap(ends, at_low, at_mid, at_high, body, numbers, pair, shape, gap, sag)
        found[row, RUSH] = proven_rush(speeds, spins, at_low, at_mid, at_high, body, radius[body], worst, width)
        found[row, CLEAR_MID] = met_near(gap[0], shape, worst[STRAY, body]) - numbers[pair, RADII]
        found[row, RUSH_MID] = rush_met(speeds, spins, at_mid, body, radius[body], worst)
        found[row, BOUND] = 0.0
    return known, rows


@compiled
def fits(
    known: CurveConfigurations, curve: Curve, field: Field, leaves: Rows, profile: Floats, law: Floats, index: float
) -> tuple[CurveConfigurations, bool, Rows]:
    """True where no row is proven to exceed `index` (see `CompiledPath.fits`), and the rows as far as halved."""
    kept, used, laws, kinds = room_for(2 * leaves.whole.shape[0]), 0, field.numbers, field.whole
    for depth in range(LOWER_DEPTH + 1):
        count = leaves.whole.shape[0]
        kept, begun, over = with_space(kept, used, count), used, np.empty(count, np.int64)
        used, over_used, hopeless = sorted_out(
            leaves.whole, leaves.numbers, kept.whole, kept.numbers, used, kinds, laws, profile, law, index, over
        )
        if over_used == 0 or hopeless or depth == LOWER_DEPTH:
            return known, over_used == 0, with_all(kept, begun, leaves)  # all of this level, proven or not
        known, leaves = examined(known, curve, field, halves(leaves.whole, over, over_used))
    return known, False, kept


@compiled
def blow(
    known: CurveConfigurations,
    curve: Curve,
    field: Field,
    people: Whole,
    profile: Floats,
    law: Floats,
    first: int,
    depths: int,
    resolution: float,
) -> tuple[CurveConfigurations, float]:
    """Proven highest share of a body region's limit speed on this course (PHY-4).

    A row whose speed alone proves no more than is met anyway, or that its balls prove to be out of reach, is settled
    without a distance.
    """
    arm, numbers, whole, radius, half = curve.arm, field.numbers, field.whole, curve.arm.radius, curve.arm.half
    asked, step = np.empty((people.shape[0] * first, WHOLES), np.int64), GRID // first
    for k in range(first):
        for each in range(people.shape[0]):
            row = k * people.shape[0] + each
            asked[row, LOW], asked[row, HIGH], asked[row, PAIR] = k * step, (k + 1) * step, people[each]
    room = np.empty((BENDS, arm.link.shape[0]))
    worst, at_low, at_mid, at_high, rate, rate_mid = room, 0, 0, 0, 0.0, 0.0
    proven = best = 0.0
    for depth in range(depths + 1):
        count = asked.shape[0]
        wide, wide_used, bounds = np.empty(count, np.int64), 0, np.empty(count)
        before = proven  # a bound that this level settles must not settle more of it
        known = with_room(known, 3 * _intervals(asked))
        nodes = known.nodes
        ends, placed, speeds, spins = nodes.ends, nodes.known, nodes.speed, nodes.spin
        for row in range(count):
            low, high, pair = asked[row, LOW], asked[row, HIGH], asked[row, PAIR]
            body, shape, width = whole[pair, BODY], whole[pair, SHAPE], (high - low) / GRID
            if row == 0 or low != asked[row - 1, LOW] or high != asked[row - 1, HIGH]:
                at_low, at_mid, at_high = rows_of(known, low, high, curve)
                worst = worst_on(curve.bends, curve.low, curve.high, low, high, room)
                rate, rate_mid = (
                    highest_rate(low / GRID, high / GRID, profile),
                    rate_at((low + high) // 2 / GRID, profile),
                )
            for at in (at_low, at_mid, at_high):
                if not placed[at, body]:
                    place(nodes, at, arm, body)
            speed = proven_rush(speeds, spins, at_low, at_mid, at_high, body, radius[body], worst, width) * rate
            bounds[row] = speed / numbers[pair, LIMIT_SPEED]
            if depth < depths and bounds[row] <= max(before, best) + resolution:
                proven = max(proven, bounds[row])
                continue
            apart = ball_gap(ends, at_mid, body, half, numbers, pair) - rough_stray(worst, body, width)
            if blow_of(numbers, pair, apart, speed, law) <= 0.0:
                continue
            gap = core_gap(ends, at_mid, body, numbers, pair, shape)
            sag = sag_on(worst, body, width)
            clear = interval_gap(ends, at_low, at_mid, at_high, body, numbers, pair, shape, gap, sag)
            bounds[row] = blow_of(numbers, pair, clear, speed, law)
            near = met_near(gap[0], shape, worst[STRAY, body]) - numbers[pair, RADII]
            speed = rush_met(speeds, spins, at_mid, body, radius[body], worst) * rate_mid
            best = max(best, blow_of(numbers, pair, near, speed, law))
            wide[wide_used] = row
            wide_used += 1
        open_used = 0
        for each in range(wide_used):
            row = wide[each]
            if depth < depths and bounds[row] > max(before, best) + resolution:
                wide[open_used] = row
                open_used += 1
            else:
                proven = max(proven, bounds[row])
        if open_used == 0:
            break
        asked = halves(asked, wide, open_used)
    return known, proven


@compiled
def rushes(known: CurveConfigurations, curve: Curve, low: Whole, high: Whole) -> tuple[CurveConfigurations, Floats]:
    """Bound on the surface speed per unit of ds/dt of every body on each interval, shape (intervals, bodies).

    Of bodies that are seen from the arm itself it is the rough one: nobody asks how fast the arm passes itself.
    """
    arm = curve.arm
    bodies = arm.link.shape[0]
    found, room = np.empty((low.shape[0], bodies)), np.empty((BENDS, bodies))
    known = with_room(known, 3 * low.shape[0])
    nodes, radius, reference = known.nodes, arm.radius, arm.reference
    speeds, spins, outer = nodes.speed, nodes.spin, np.flatnonzero(arm.reference == 0)
    for k in range(low.shape[0]):
        at_low, at_mid, at_high = rows_of(known, low[k], high[k], curve)
        worst = worst_on(curve.bends, curve.low, curve.high, low[k], high[k], room)
        width = (high[k] - low[k]) / GRID
        for at in (at_low, at_mid, at_high):
            place_all(nodes, at, arm, outer)
        for body in range(bodies):
            if reference[body] > 0:
                found[k, body] = rough_rush(worst, body, width, radius[body])
            else:
                found[k, body] = proven_rush(speeds, spins, at_low, at_mid, at_high, body, radius[body], worst, width)
    return known, found


@compiled
def met_at(
    known: CurveConfigurations, curve: Curve, field: Field, key: int, pair: Whole
) -> tuple[CurveConfigurations, Floats, Floats]:
    """Signed clearance and surface speed per unit of ds/dt of these pairs at one configuration of the course itself."""
    known = with_room(known, 1)
    at, nodes, arm = row_of(known, key, curve), known.nodes, curve.arm
    clearance, rush = np.empty(pair.shape[0]), np.empty(pair.shape[0])
    ends, placed, speeds, spins, radius = nodes.ends, nodes.known, nodes.speed, nodes.spin, arm.radius
    whole, numbers = field.whole, field.numbers
    for row in range(pair.shape[0]):
        k = pair[row]
        body = whole[k, BODY]
        if not placed[at, body]:
            place(nodes, at, arm, body)
        gap = core_gap(ends, at, body, numbers, k, whole[k, SHAPE])
        clearance[row] = gap[0] - numbers[k, RADII]
        rush[row] = speeds[at, body] + radius[body] * spins[at, body]
    return known, clearance, rush


@entry
def answered(
    what: int,
    known: CurveConfigurations,
    curve: Curve,
    field: Field,
    rows: Rows,
    profile: Floats,
    law: Floats,
    numbers: Floats,
) -> tuple[CurveConfigurations, Rows, float]:
    """Answer to one of the path's own questions.

    One entry for all, since machine code is made for each with all that it calls.

    Args:
        what: `EXAMINED`, `FITS`, `BLOW`, `RUSHES` or `MET_AT`.
        known: the configurations known by now.
        curve, field: the path, and all pairs.
        rows: which rows, intervals or pairs are asked about, in the columns of `Rows`.
        profile, law: timing and stop, where the question has to do with them.
        numbers: of `FITS` the index; of `BLOW` intervals of the first cut, halvings and resolution; of `MET_AT` the
            place in 1 / GRID.

    Returns:
        The configurations known by then; rows as the question has them: of `RUSHES` the speeds of all bodies, of
        `MET_AT` clearance and speed; and 1 where `FITS` is proven, or the share of `BLOW`.
    """
    whole, count = rows.whole, rows.whole.shape[0]
    if what == EXAMINED:
        known, found = examined(known, curve, field, whole)
        return known, found, 0.0
    if what == FITS:
        known, proven, kept = fits(known, curve, field, rows, profile, law, numbers[0])
        return known, kept, 1.0 if proven else 0.0
    if what == BLOW:
        first, depths = int(numbers[0]), int(numbers[1])
        known, share = blow(known, curve, field, whole[:, PAIR].copy(), profile, law, first, depths, numbers[2])
        return known, rows, share
    if what == RUSHES:
        known, most = rushes(known, curve, whole[:, LOW].copy(), whole[:, HIGH].copy())
        return known, Rows(whole, most), 0.0
    met = np.empty((count, 2))  # clearance and speed
    known, clearance, rush = met_at(known, curve, field, int(numbers[0]), whole[:, PAIR].copy())
    for row in range(count):
        met[row, 0], met[row, 1] = clearance[row], rush[row]
    return known, Rows(whole, met), 0.0

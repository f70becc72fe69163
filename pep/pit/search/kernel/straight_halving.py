"""Halving of rows until they are proven: lower speeds, blows, and the path's own questions.

Here intervals come in any order, so configurations are found by their key, in a small table with open addresses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import BODY, PEAK, WAY
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.certify import LOWER_DEPTH
from pep.pit.search.kernel.arithmetic.body_poses import no_nodes, place, place_all
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry, lent
from pep.pit.search.kernel.arithmetic.index_law import blow_of, highest_rate, rate_at
from pep.pit.search.kernel.arithmetic.pair_rows import (
    ball_gap,
    configuration,
    examine,
    meets,
    rush_at_most,
    strays_at_most,
)
from pep.pit.search.kernel.arithmetic.row_table import (
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
    from pep.pit.search.kernel.arithmetic.body_poses import Nodes
    from pep.pit.search.kernel.arithmetic.pair_rows import Field, StraightPath

    Whole = NDArray[np.int64]

FIRST: Final = 128  # places in the table at first, a power of two
SPREAD: Final = 0x9E3779B1  # 2^32 by the golden ratio: neighbouring keys land far apart (Knuth, TAOCP 3, 6.4)
FREE: Final = -1

# What may be asked of a path, of `answered`.
EXAMINED, FITS, BLOW, RUSHES, MET_AT = range(5)


class StraightConfigurations(NamedTuple):
    """Configurations computed so far: their nodes, and the row of each key. At most half of the places are used."""

    nodes: Nodes
    key: Whole
    row: Whole
    used: Whole


def nothing_known(bodies: int) -> StraightConfigurations:
    """No configuration."""
    made: Any = no_nodes
    return StraightConfigurations(
        made.py_func(FIRST // 2, bodies), np.full(FIRST, FREE), np.full(FIRST, FREE), np.zeros(1, np.int64)
    )


@lent
def _place_of(table: Whole, key: int) -> int:
    """Place of the key in the table, taken or free."""
    at = ((key >> 2) * SPREAD >> 8) & (table.shape[0] - 1)
    while table[at] != FREE and table[at] != key:
        at = (at + 1) & (table.shape[0] - 1)
    return at


@compiled
def with_key(known: StraightConfigurations, key: int, way: StraightPath) -> StraightConfigurations:
    """The same with the configuration at `key`."""
    at = _place_of(known.key, key)
    if known.key[at] == key:
        return known
    row = known.used[0]
    if 2 * row >= known.key.shape[0]:
        keys, rows = np.full(2 * known.key.shape[0], FREE), np.full(2 * known.key.shape[0], FREE)
        for old in range(known.key.shape[0]):
            if known.key[old] != FREE:
                to = _place_of(keys, known.key[old])
                keys[to], rows[to] = known.key[old], known.row[old]
        known = StraightConfigurations(known.nodes, keys, rows, known.used)
        at = _place_of(known.key, key)
    known.key[at], known.row[at] = key, row
    known.used[0] = row + 1
    return StraightConfigurations(configuration(known.nodes, row, way, key), known.key, known.row, known.used)


@compiled
def examined(
    known: StraightConfigurations, way: StraightPath, field: Field, asked: Whole
) -> tuple[StraightConfigurations, Rows]:
    """The rows (LOW, HIGH, PAIR) of `asked` examined, and the configurations known by then."""
    stand = np.empty((asked.shape[0], 3), np.int64)
    for row in range(asked.shape[0]):
        low, high = asked[row, LOW], asked[row, HIGH]
        if row > 0 and low == asked[row - 1, LOW] and high == asked[row - 1, HIGH]:
            stand[row, 0], stand[row, 1], stand[row, 2] = stand[row - 1, 0], stand[row - 1, 1], stand[row - 1, 2]
            continue
        mid = (low + high) // 2
        known = with_key(with_key(with_key(known, low, way), mid, way), high, way)
        stand[row, 0] = known.row[_place_of(known.key, low)]
        stand[row, 1] = known.row[_place_of(known.key, mid)]
        stand[row, 2] = known.row[_place_of(known.key, high)]
    return known, examine(known.nodes, way, field, asked, stand)


@compiled
def fits(
    known: StraightConfigurations,
    way: StraightPath,
    field: Field,
    leaves: Rows,
    profile: Floats,
    law: Floats,
    index: float,
) -> tuple[StraightConfigurations, bool, Rows]:
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
        known, leaves = examined(known, way, field, halves(leaves.whole, over, over_used))
    return known, False, kept


@compiled
def blow(
    known: StraightConfigurations,
    way: StraightPath,
    field: Field,
    people: Whole,
    profile: Floats,
    law: Floats,
    first: int,
    depths: int,
    resolution: float,
) -> tuple[StraightConfigurations, float]:
    """Proven highest share of a body region's limit speed on this path (PHY-4)."""
    asked, used = np.empty((people.shape[0] * first, WHOLES), np.int64), 0
    width = 1.0 / first
    top_rate = profile[PEAK] / profile[WAY]
    for k in range(first):
        begin, end = k * (GRID // first), (k + 1) * (GRID // first)
        known = with_key(known, (begin + end) // 2, way)
        middle = known.row[_place_of(known.key, (begin + end) // 2)]
        for each in range(people.shape[0]):
            row = people[each]
            body = field.whole[row, BODY]
            if not known.nodes.known[middle, body]:
                place(known.nodes, middle, way.arm, body)
            gap = ball_gap(known.nodes.ends, middle, body, way.arm.half, field.numbers, row)
            gap -= strays_at_most(way, body, width)
            if blow_of(field.numbers, row, gap, rush_at_most(way, body, width) * top_rate, law) > 0.0:
                asked[used, LOW], asked[used, HIGH], asked[used, PAIR] = begin, end, row
                used += 1
    asked = asked[:used].copy()
    proven = best = 0.0
    for depth in range(depths + 1):
        known, rows = examined(known, way, field, asked)
        numbers, count = rows.numbers, asked.shape[0]
        bounds, wide = np.empty(count), np.empty(count, np.int64)
        wide_used = 0
        for row in range(count):
            low, high, met = asked[row, LOW], asked[row, HIGH], asked[row, PAIR]
            rate = highest_rate(low / GRID, high / GRID, profile)
            bounds[row] = blow_of(field.numbers, met, numbers[row, CLEAR], numbers[row, RUSH] * rate, law)
            speed = numbers[row, RUSH_MID] * rate_at((low + high) // 2 / GRID, profile)
            best = max(best, blow_of(field.numbers, met, numbers[row, CLEAR_MID], speed, law))
        enough = max(proven, best) + resolution
        for row in range(count):
            if depth < depths and bounds[row] > enough:
                wide[wide_used] = row
                wide_used += 1
            else:
                proven = max(proven, bounds[row])
        if wide_used == 0:
            break
        asked = halves(asked, wide, wide_used)
    return known, proven


@compiled
def rushes(
    known: StraightConfigurations, way: StraightPath, low: Whole, high: Whole
) -> tuple[StraightConfigurations, Floats]:
    """Bound on the surface speed per unit of ds/dt of every body on each interval, shape (intervals, bodies).

    Of bodies that are seen from the arm itself it is the rough one: nobody asks how fast the arm passes itself.
    """
    arm, bends, intervals = way.arm, way.bends, low.shape[0]
    references, radius, first, third = arm.reference, arm.radius, bends.first, bends.third
    spin_most, spin_second = bends.spin, bends.spin_second
    count, bodies = references.shape[0], np.flatnonzero(references == 0)
    found, stand = np.empty((intervals, count)), np.empty((intervals, 3), np.int64)
    for k in range(intervals):
        mid = (low[k] + high[k]) // 2
        if k > 0 and low[k] == high[k - 1]:  # most follow each other
            stand[k, 0] = stand[k - 1, 2]
        else:
            known = with_key(known, low[k], way)
            stand[k, 0] = known.row[_place_of(known.key, low[k])]
        known = with_key(with_key(known, mid, way), high[k], way)
        stand[k, 1] = known.row[_place_of(known.key, mid)]
        stand[k, 2] = known.row[_place_of(known.key, high[k])]
    nodes, speeds, spins = known.nodes, known.nodes.speed, known.nodes.spin
    for k in range(intervals):
        at_low, at_mid, at_high = stand[k, 0], stand[k, 1], stand[k, 2]
        for at in (at_low, at_mid, at_high):
            place_all(nodes, at, arm, bodies)
        bend = ((high[k] - low[k]) / GRID) ** 2 / CHORD
        for body in range(count):
            if references[body] > 0:
                speed, spin = first[body], spin_most[body]
            else:
                speed = max(speeds[at_low, body], speeds[at_mid, body], speeds[at_high, body])
                spin = max(spins[at_low, body], spins[at_mid, body], spins[at_high, body])
            speed += third[body] * bend
            found[k, body] = speed + radius[body] * (spin + spin_second[body] * bend)
    return known, found


@compiled
def met_at(
    known: StraightConfigurations, way: StraightPath, field: Field, key: int, pair: Whole
) -> tuple[StraightConfigurations, Floats, Floats]:
    """Signed clearance and surface speed per unit of ds/dt of these pairs at one configuration."""
    known = with_key(known, key, way)
    at = known.row[_place_of(known.key, key)]
    clearance, rush = meets(known.nodes, at, way, field, pair)
    return known, clearance, rush


@entry
def answered(
    what: int,
    known: StraightConfigurations,
    way: StraightPath,
    field: Field,
    rows: Rows,
    profile: Floats,
    law: Floats,
    numbers: Floats,
) -> tuple[StraightConfigurations, Rows, float]:
    """Answer to one of the path's own questions.

    One entry for all, since machine code is made for each with all that it calls.

    Args:
        what: `EXAMINED`, `FITS`, `BLOW`, `RUSHES` or `MET_AT`.
        known: the configurations known by now.
        way, field: the path, and all pairs.
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
        known, found = examined(known, way, field, whole)
        return known, found, 0.0
    if what == FITS:
        known, proven, kept = fits(known, way, field, rows, profile, law, numbers[0])
        return known, kept, 1.0 if proven else 0.0
    if what == BLOW:
        first, depths = int(numbers[0]), int(numbers[1])
        known, share = blow(known, way, field, whole[:, PAIR].copy(), profile, law, first, depths, numbers[2])
        return known, rows, share
    if what == RUSHES:
        known, most = rushes(known, way, whole[:, LOW].copy(), whole[:, HIGH].copy())
        return known, Rows(whole, most), 0.0
    met = np.empty((count, 2))  # clearance and speed
    known, clearance, rush = met_at(known, way, field, int(numbers[0]), whole[:, PAIR].copy())
    for row in range(count):
        met[row, 0], met[row, 1] = clearance[row], rush[row]
    return known, Rows(whole, met), 0.0

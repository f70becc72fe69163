"""Rows of (interval, pair) with their proven bounds, as two tables; and rows still to be proven."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import KIND
from pep.pit.base.tier import TIE
from pep.pit.path.straight_path import GRID
from pep.pit.search.kernel.arithmetic.compilation import compiled, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.index_law import highest_rate, pair_index, rate_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats

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
    """Rows as `pep.pit.path.path.Leaves` has them, and the index proven on each: (n, WHOLES) and (n, NUMBERS)."""

    whole: Whole
    numbers: Floats


@compiled
def room_for(count: int) -> Rows:
    """Room for so many rows."""
    return Rows(np.empty((count, WHOLES), np.int64), np.empty((count, NUMBERS)))


@compiled
def with_space(rows: Rows, used: int, count: int) -> Rows:
    """The first `used` rows, with room for so many more."""
    if used + count <= rows.whole.shape[0]:
        return rows
    wide = room_for(used + max(used, count))
    copy_into(wide.whole, rows.whole[:used])
    copy_into(wide.numbers, rows.numbers[:used])
    return wide


@compiled
def copied(rows: Rows, used: int) -> Rows:
    """The first `used` rows alone."""
    return Rows(rows.whole[:used].copy(), rows.numbers[:used].copy())


@compiled
def halves(rows: Whole, which: Whole, count: int) -> Whole:
    """Both halves of those rows' intervals, with their pairs; rows of one interval stay together."""
    halves = np.empty((2 * count, WHOLES), np.int64)
    for to in range(count):
        low, high, pair = rows[which[to], LOW], rows[which[to], HIGH], rows[which[to], PAIR]
        mid = (low + high) // 2
        halves[to, LOW], halves[to, HIGH], halves[to, PAIR] = low, mid, pair
        halves[count + to, LOW], halves[count + to, HIGH], halves[count + to, PAIR] = mid, high, pair
    return halves


@lent
def sorted_out(
    whole: Whole,
    numbers: Floats,
    kept_whole: Whole,
    kept_numbers: Floats,
    used: int,
    kinds: Whole,
    laws: Floats,
    profile: Floats,
    law: Floats,
    index: float,
    over: Whole,
) -> tuple[int, int, bool]:
    """Keeps the rows with a proven `index`, from `used` on, and writes the numbers of the others to `over`.

    Args:
        whole, numbers: the rows.
        kept_whole, kept_numbers: those that are kept.
        used: number of rows in use.
        kinds, laws: of all pairs (`rows.Field`).
        profile, law: the timing, and how it ends.
        index: to be proven.
        over: room for a number of each row.

    Returns:
        How many are kept now, how many stand in `over`, and whether more than `index` was met, which ends the look.
    """
    over_used = 0
    for row in range(whole.shape[0]):
        low, high, pair = whole[row, LOW], whole[row, HIGH], whole[row, PAIR]
        kind, rate = kinds[pair, KIND], highest_rate(low / GRID, high / GRID, profile)
        speed = numbers[row, RUSH] * rate
        if pair_index(kind, laws, pair, numbers[row, CLEAR], speed, law) <= index + TIE:
            for column in range(WHOLES):
                kept_whole[used, column] = whole[row, column]
            for column in range(NUMBERS):
                kept_numbers[used, column] = numbers[row, column]
            used += 1
            continue
        over[over_used] = row
        over_used += 1
        speed = numbers[row, RUSH_MID] * rate_at((low + high) // 2 / GRID, profile)
        if pair_index(kind, laws, pair, numbers[row, CLEAR_MID], speed, law) > index + TIE:
            return used, over_used, True
    return used, over_used, False


@compiled
def with_all(kept: Rows, used: int, rows: Rows) -> Rows:
    """The first `used` rows, then all of the others; there is room for them."""
    count = rows.whole.shape[0]
    kept.whole[used : used + count], kept.numbers[used : used + count] = rows.whole, rows.numbers
    return copied(kept, used + count)

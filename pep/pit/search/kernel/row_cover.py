"""Check of a straight search's rows: they tile the path of each pair that was asked about."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.tier import HIGHEST, MOVING
from pep.pit.path.straight_path import GRID
from pep.pit.search.kernel.arithmetic.compilation import entry, lent
from pep.pit.search.kernel.interval_tree import FIRST
from pep.pit.search.kernel.search_columns import LEAF, LEAF_HIGH, LEAF_LOW, LEAF_PAIR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats

    Whole = NDArray[np.int64]

CELL: Final = GRID // FIRST  # of the first cut
LEAF_INDEX: Final = LEAF - 1
# They spread each bit of a place over all of its mark (SplitMix64: Steele, Lea and Flood, 2014).
_SPREAD: Final = 0xBF58476D1CE4E5B9
_SPREAD_AGAIN: Final = 0x94D049BB133111EB


@lent
def _mark(place: int) -> np.uint64:
    """Number that stands for a place of the path.

    It has no sign: only such a number may run over.
    """
    mark = np.uint64(place)
    mark = (mark ^ (mark >> np.uint64(30))) * np.uint64(_SPREAD)
    mark = (mark ^ (mark >> np.uint64(27))) * np.uint64(_SPREAD_AGAIN)
    return mark ^ (mark >> np.uint64(31))


@entry
def tiled_index(leaves: Floats, far: Whole, pairs: Whole) -> float:
    """Highest index of rows that tile the path of each of these pairs.

    It is infinite where they do not, or where a row is of another pair.

    Each row adds its end's mark to its cell and takes its begin's off. Rows one behind the other leave those of the
    whole cell; any other rows leave the marks of places where one is missing or too many.

    Args:
        leaves: the rows, in `LEAF` columns.
        far: for each pair, the cells of the first cut that have no row, as bits: those count as any motion does.
        pairs: the pairs that were asked about.
    """
    open_, highest = np.zeros((far.shape[0], FIRST), np.uint64), MOVING
    for cell in range(FIRST):
        whole = _mark((cell + 1) * CELL) - _mark(cell * CELL)
        for pair in pairs:
            if not far[pair] >> cell & 1:
                open_[pair, cell] = whole
    for row in range(leaves.shape[0]):
        low, high, pair = int(leaves[row, LEAF_LOW]), int(leaves[row, LEAF_HIGH]), int(leaves[row, LEAF_PAIR])
        if not (0 <= low < high <= GRID and 0 <= pair < far.shape[0] and leaves[row, LEAF_INDEX] <= HIGHEST):
            return math.inf
        open_[pair, low // CELL] -= _mark(high) - _mark(low)
        highest = max(highest, leaves[row, LEAF_INDEX])
    for pair in range(far.shape[0]):
        for cell in range(FIRST):
            if open_[pair, cell] != 0:
                return math.inf
    return highest

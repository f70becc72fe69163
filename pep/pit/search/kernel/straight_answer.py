"""Answer of the kernel in its own arrays, with derived members made at their first use."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.tier import MOVING, TIE
from pep.pit.path.path import Leaves
from pep.pit.search.certify import Certified, Proof, Witness
from pep.pit.search.kernel.interval_tree import FIRST
from pep.pit.search.kernel.row_cover import CELL, LEAF_INDEX, tiled_index
from pep.pit.search.kernel.search_columns import LEAF_NUMBERS, MET

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.scene.obstacles import PairKind
    from pep.pit.scene.pairs import Pairs


_CELLS: Final = 1 << np.arange(FIRST)[:, None]


class StraightFindings(NamedTuple):
    """Findings of `kernel.straight.certify`, with their question.

    Attributes:
        pairs, rows: all pairs, and those in question.
        told, broken: numbers of witnesses and violations.
        found: those, in `MET` columns, then leaves, in `LEAF` columns.
        far: for each pair the spans of the first cut on which it was found far apart, as bits.
    """

    pairs: Pairs
    rows: NDArray[np.intp]
    told: int
    broken: int
    found: Floats
    far: NDArray[np.int64]

    @property
    def leaves(self) -> Floats:
        """The leaves alone."""
        return self.found[self.told + self.broken :]


class StraightCertified(Certified):
    """Answer as of `Certified`, with leaves for rows that were looked at one by one only.

    The rest of the proof is what was found to be far apart.
    """

    def __init__(self, found: StraightFindings, *, upper: float, attained: float, slower: float | None) -> None:
        """Keeps the arrays; nothing is made of them yet."""
        vars(self).update(_found=found, upper=upper, attained=attained, slower=slower)

    _found: StraightFindings
    upper: float
    attained: float
    slower: float | None

    @cached_property
    def witnesses(self) -> tuple[Witness, ...]:
        """As `Certified.witnesses`."""
        return _witnesses(self._found.found[: self._found.told])

    @cached_property
    def violated(self) -> dict[PairKind, Witness]:
        """As `Certified.violated`."""
        pairs, _, told, broken, found, _ = self._found
        return {pairs.kind_of(w.pair): w for w in _witnesses(found[told : told + broken])}

    @cached_property
    def leaves(self) -> Leaves:
        """As `Certified.leaves`."""
        found = np.ascontiguousarray(self._found.leaves.T)
        return Leaves(*found[:LEAF_NUMBERS].astype(np.int64), *found[LEAF_NUMBERS:-1])

    @cached_property
    def leaf_index(self) -> Floats:
        """As `Certified.leaf_index`."""
        return self._found.leaves[:, LEAF_INDEX].copy()

    def proves(self, asked: NDArray[np.intp], index: float) -> bool:
        """As `Certified.proves`."""
        return bool(tiled_index(self._found.leaves, self._found.far, asked) <= index + TIE)

    @property
    def proof(self) -> Proof:
        """As `Certified.proof`."""
        leaves, rows = self.leaves, self._found.rows
        cell, row = np.nonzero(self._found.far[rows] & _CELLS)
        return Proof(
            np.concatenate([leaves.pair, rows[row]]),
            np.concatenate([leaves.low, cell * CELL]),
            np.concatenate([leaves.high, cell * CELL + CELL]),
            np.concatenate([self.leaf_index, np.full(len(row), MOVING)]),
        )


def _witnesses(met: Floats) -> tuple[Witness, ...]:
    return tuple(
        [Witness(int(key), int(pair), index, gap, speed) for index, gap, speed, key, pair in met[:, :MET].tolist()]
    )

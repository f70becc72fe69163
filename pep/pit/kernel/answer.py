"""What the kernel proved, in its own arrays; what only some ask for is made of them when somebody does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.certify import Certified, Proof, Witness
from pep.pit.kernel.known import LEAF_NUMBERS
from pep.pit.path import GRID, Leaves
from pep.pit.tier import MOVING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.motion import Floats
    from pep.pit.pairs import Kind, Pairs


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The arrays that `kernel.straight.certify` returns, and what it was asked about.

    Attributes:
        pairs, rows: all pairs, and those in question.
        witnesses, violated: `MET` columns each.
        leaves: `LEAF` rows.
        far: shape (spans of the first cut, rows), which are no leaves: they count no more than any motion.
    """

    pairs: Pairs
    rows: NDArray[np.intp]
    witnesses: Floats
    violated: Floats
    leaves: Floats
    far: NDArray[np.bool_]


class Answer(Certified):
    """As `Certified`; only what was looked at row by row is a leaf, the rest of the proof is known to be far apart."""

    def __init__(self, found: Found, *, upper: float, attained: float, slower: float | None) -> None:
        """Nothing is made of the arrays yet."""
        vars(self).update(_found=found, upper=upper, attained=attained, slower=slower)

    _found: Found
    upper: float
    attained: float
    slower: float | None

    @cached_property
    def witnesses(self) -> tuple[Witness, ...]:
        """As `Certified.witnesses`."""
        return _witnesses(self._found.witnesses)

    @cached_property
    def violated(self) -> dict[Kind, Witness]:
        """As `Certified.violated`."""
        return {self._found.pairs.kind_of(w.pair): w for w in _witnesses(self._found.violated)}

    @cached_property
    def leaves(self) -> Leaves:
        """As `Certified.leaves`."""
        found = self._found.leaves
        return Leaves(*found[:LEAF_NUMBERS].astype(np.int64), *found[LEAF_NUMBERS:-1])

    @cached_property
    def leaf_index(self) -> Floats:
        """As `Certified.leaf_index`."""
        return np.asarray(self._found.leaves[-1])

    @property
    def proof(self) -> Proof:
        """As `Certified.proof`."""
        leaves, far = self.leaves, self._found.far
        span, row = np.nonzero(far)
        low, step = span * (GRID // len(far)), GRID // len(far)
        return Proof(
            np.concatenate([leaves.pair, self._found.rows[row]]),
            np.concatenate([leaves.low, low]),
            np.concatenate([leaves.high, low + step]),
            np.concatenate([self.leaf_index, np.full(len(row), MOVING)]),
        )


def _witnesses(met: Floats) -> tuple[Witness, ...]:
    return tuple([Witness(int(key), int(pair), index, gap, speed) for index, gap, speed, key, pair in met.tolist()])

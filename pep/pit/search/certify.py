"""Branch and bound on the impact index of a whole path: a proven bound, and a witness near it.

Each row is one pair on one interval of the path. Its own proven clearance meets its own proven speed there, so a slow
link near the table and a fast one far from it do not add up to a fast one near it. Rows that cannot raise the answer
are kept as leaves; the others are halved. The leaves of every pair tile the whole path: they are the certificate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.errors import UnprovenError
from pep.pit.base.tier import TIE
from pep.pit.path.straight_path import GRID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.path.path import Keys, Leaves, Route
    from pep.pit.scene.obstacles import PairKind
    from pep.pit.scene.pairs import Pairs

FIRST_CUT_LEAST: Final = 8  # intervals of the first cut; fewer only add a level
FIRST_CUT_MOST: Final = 64  # more cost time on every pair
RADIANS_PER_CUT: Final = 0.5  # summed way of all joints per first interval: keeps the first bounds useful
DEPTH: Final = 14  # halvings; an interval so short is 1e-5 of the path
RESOLUTION: Final = 0.01  # PHY-9: index within which upper bound and witness may differ, inside one tier
VIOLATION_RESOLUTION_M: Final = 1e-4  # a path that grazes to within this without touching is no violation
ROWS_MOST: Final = 200_000  # rows examined in one question: bounds memory and time in every scene
SPEED_STEPS: Final = 9  # bisections of the speed: 1 / 500 of it, finer than anyone drives
BLOW_DEPTH: Final = 7  # halvings in the search for the worst blow; a row that is still open counts with its bound
BLOW_RESOLUTION: Final = 0.01  # PHY-4: ratio within which bound and attained value of a blow may differ
LOWER_DEPTH: Final = 6  # halvings in the search for a lower tier: enough for 1 % of the speed


class Witness(NamedTuple):
    """Point of the path where a pair attains an index."""

    key: int
    pair: int
    index: float  # type: ignore[assignment]  # not a tuple's: no caller looks for a number's place in a witness
    clearance_m: float
    speed_m_s: float

    @property
    def s(self) -> float:
        """Path parameter."""
        return self.key / GRID


class Slower(NamedTuple):
    """Numbers for the search of a slower speed of the same motion.

    Attributes:
        stop_delay_s, stop_deceleration_rad_s2: the stop of the cell's arm.
        slowest_rad_s: a slower one is of no use.
        commanded_rad_s: the speed that was asked about.
    """

    stop_delay_s: float
    stop_deceleration_rad_s2: float
    slowest_rad_s: float
    commanded_rad_s: float


class Proof(NamedTuple):
    """Certificate: rows of a pair, an interval in 1 / GRID and its proven index.

    The rows cover the path.
    """

    pair: NDArray[np.intp]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    index: Floats  # type: ignore[assignment]  # not a tuple's, as of a witness


@dataclass(frozen=True)
class Certified:
    """The answer of the search.

    Attributes:
        upper: proven: no pair exceeds this index anywhere on the path.
        attained: the highest index that was met, `upper` minus at most the resolution unless the depth ran out.
        witnesses: per obstacle (kind and name) the point with the highest index met, highest first.
        violated: per violated kind the point with the deepest clearance met.
        leaves: the rows of the search that were not halved; `proof` has what an engine need not write down.
        leaf_index: the proven index of each leaf.
        slower: the highest commanded speed, to a step of the bisection, at which the index of these pairs is proven to
            be a whole tier lower, rad/s; None where there is none, or no engine was asked for it.
    """

    upper: float
    attained: float
    witnesses: tuple[Witness, ...]
    violated: dict[PairKind, Witness]
    leaves: Leaves
    leaf_index: Floats
    slower: float | None = None

    @property
    def proof(self) -> Proof:
        """Certificate of the search: for every pair its intervals cover the whole path."""
        return Proof(self.leaves.pair, self.leaves.low, self.leaves.high, self.leaf_index)

    def proves(self, asked: NDArray[np.intp], index: float) -> bool:
        """True where the rows tile the path of each of these pairs, and prove no higher index."""
        return proven(asked, self.proof, index)


def proven(asked: NDArray[np.intp], proof: Proof, index: float) -> bool:
    """True where the rows of `proof` tile the path of each asked pair, no other, and have no higher index."""
    pair, low, high, bound = proof
    inside = bool((low >= 0).all()) and bool((high <= GRID).all())
    begin, path = pair * GRID, asked * GRID
    return inside and tiled(begin + low, begin + high, path, path + GRID) and bool(bound.max(initial=0) <= index + TIE)


def tiled(begin: Keys, end: Keys, first: Keys, last: Keys) -> bool:
    """True where the intervals from `begin` to `end` cover those from `first` to `last` once, and nothing else.

    These lie apart from each other. How many intervals lie over a place changes only where one begins or ends: it is
    the same number everywhere when all changes are the same.
    """
    begins, ends = np.concatenate([begin, last]), np.concatenate([end, first])
    begins.sort()
    ends.sort()
    return bool((begin < end).all()) and np.array_equal(begins, ends)


def first_cut(path: Route, pairs: Pairs, rows: NDArray[np.intp], *, since: int = 0) -> Leaves:
    """Every pair of `rows` on every interval of the first cut that reaches beyond `since`, examined."""
    low, high = cut(path)
    low, high = low[high > since], high[high > since]
    count = len(low)
    return path.examine(pairs, np.repeat(low, len(rows)), np.repeat(high, len(rows)), np.tile(rows, count))


def cut(path: Route) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Equal intervals, as many as `cuts` says."""
    count = cuts(path)
    edges = np.arange(count + 1, dtype=np.int64) * (GRID // count)
    return edges[:-1], edges[1:]


def cuts(path: Route) -> int:
    """Number of intervals of the first cut: a power of two, more for a longer way."""
    wanted = float(np.abs(path.delta).sum()) / RADIANS_PER_CUT
    count = FIRST_CUT_LEAST
    while count < min(wanted, FIRST_CUT_MOST):
        count *= 2
    return count


def refuse_hidden(pairs: Pairs, found: Certified) -> None:
    """Every violation of the motion is among those that were met.

    Raises:
        UnprovenError: a row that the search could not follow farther may hide one of another kind.
    """
    leaves = found.leaves
    below = pairs.violated_below[leaves.pair] - VIOLATION_RESOLUTION_M
    hiding = np.unique(pairs.kind[leaves.pair[leaves.clear_m < below]]).tolist()
    if not {pairs.code_of(kind) for kind in found.violated}.issuperset(hiding):
        raise UnprovenError("violation")


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a proof with a given index: proven or not, and the leaves.

    The leaves are halved as far as necessary; they hold for any profile.
    """

    leaves: Leaves
    proven: bool

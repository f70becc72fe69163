"""Branch and bound on the impact index of a whole path: a proven upper bound, and a witness that attains nearly it.

Each row is one pair on one interval of the path. Its own proven clearance meets its own proven speed there, so a slow
link near the table and a fast one far from it do not add up to a fast one near it. Rows that cannot raise the answer
are kept as leaves; the others are halved. The leaves of every pair cover the whole path: they are the certificate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.errors import WorkLimitError
from pep.pit.base.tier import TIE
from pep.pit.path.path import Leaves
from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import VIOLABLE, Kind

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Route
    from pep.pit.scene.pairs import Pairs

FIRST_CUT_LEAST: Final = 8  # intervals of the first cut; fewer only add a level
FIRST_CUT_MOST: Final = 64  # more cost time on every pair
RADIANS_PER_CUT: Final = 0.5  # summed way of all joints per first interval: keeps the first bounds useful
DEPTH: Final = 14  # halvings; an interval so short is 1e-5 of the path
RESOLUTION: Final = 0.01  # PHY-9: index within which upper bound and witness may differ, inside one tier
VIOLATION_RESOLUTION_M: Final = 1e-4  # a path that grazes to within this without touching is no violation
ROWS_MOST: Final = 200_000  # rows examined in one question: bounds memory and time whatever the scene
SPEED_STEPS: Final = 9  # bisections of the speed: 1 / 500 of it, finer than anyone drives
LOWER_DEPTH: Final = 6  # halvings in the search for a lower tier: enough for 1 % of the speed


class Witness(NamedTuple):
    """A point of the path where a pair attains an index."""

    key: int
    pair: int
    index: float  # type: ignore[assignment]  # not a tuple's: nobody looks for a number's place in a witness
    clearance_m: float
    speed_m_s: float

    @property
    def s(self) -> float:
        """Path parameter."""
        return self.key / GRID


class Slower(NamedTuple):
    """What a slower speed of the same motion is found by.

    Attributes:
        stop_delay_s, stop_deceleration_rad_s2: how the cell's arm stops.
        slowest_rad_s: a slower one is of no use.
        commanded_rad_s: the speed that was asked about.
    """

    stop_delay_s: float
    stop_deceleration_rad_s2: float
    slowest_rad_s: float
    commanded_rad_s: float


class Proof(NamedTuple):
    """The certificate: rows of a pair, an interval in 1 / GRID and the index proven there, which cover the path."""

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
    violated: dict[Kind, Witness]
    leaves: Leaves
    leaf_index: Floats
    slower: float | None = None

    @property
    def proof(self) -> Proof:
        """The certificate: for every pair its intervals cover the whole path."""
        return Proof(self.leaves.pair, self.leaves.low, self.leaves.high, self.leaf_index)


def first_cut(path: Route, pairs: Pairs, rows: NDArray[np.intp], *, since: int = 0) -> Leaves:
    """Every pair of `rows` on every interval of the first cut that reaches beyond `since`, examined."""
    low, high = cut(path)
    low, high = low[high > since], high[high > since]
    count = len(low)
    return path.examine(pairs, np.repeat(low, len(rows)), np.repeat(high, len(rows)), np.tile(rows, count))


def cut(path: Route) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Equal intervals, so many as `cuts` says."""
    count = cuts(path)
    edges = np.arange(count + 1, dtype=np.int64) * (GRID // count)
    return edges[:-1], edges[1:]


def cuts(path: Route) -> int:
    """How many intervals the first cut has: a power of two, more for a longer way."""
    wanted = float(np.abs(path.delta).sum()) / RADIANS_PER_CUT
    count = FIRST_CUT_LEAST
    while count < min(wanted, FIRST_CUT_MOST):
        count *= 2
    return count


def _tiers(index: Floats) -> Floats:
    return np.asarray(np.ceil(index - TIE))


def certify(
    path: Route,
    pairs: Pairs,
    profile: Profile,
    stop: Stopping,
    *,
    rows: NDArray[np.intp],
    floor: float,
    check_time: Callable[[], None],
) -> Certified:
    """The proven index of these pairs on this path.

    Args:
        path: the joint path.
        pairs: what could meet what.
        profile: its timing.
        stop: how the motion ends when it must.
        rows: the pairs to ask about.
        floor: an index that holds anyway; pairs that cannot exceed it are not looked at more closely.
        check_time: raises when the answer would come too late.

    Raises:
        WorkLimitError: more rows than `ROWS_MOST` were needed.
    """
    best, upper = floor, floor
    found = _Found(pairs)
    found.at_rest(path, rows)
    done: list[Leaves] = []
    done_index: list[Floats] = []
    if len(rows) * len(cut(path)[0]) > ROWS_MOST:
        raise WorkLimitError("PHYSICS_FAULT", "the scene has too many bodies for a way this long")
    leaves = first_cut(path, pairs, rows)
    examined = 0
    for depth in range(DEPTH + 1):
        check_time()
        examined += len(leaves)
        if examined > ROWS_MOST:
            raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
        low, high, mid = leaves.low / GRID, leaves.high / GRID, leaves.mid / GRID
        bound = pairs.index(leaves.pair, leaves.clear_m, leaves.rush * profile.highest_rate(low, high), stop)
        speed_mid = leaves.rush_mid * profile.rate(mid)
        attained = pairs.index(leaves.pair, leaves.clear_mid_m, speed_mid, stop)
        found.look(leaves, attained, speed_mid)
        best = max(best, found.best)
        settled = (bound <= best) | ((bound <= best + RESOLUTION) & (_tiers(bound) <= _tiers(np.array(best))))
        settled &= ~found.doubtful(leaves)
        if depth == DEPTH:
            settled[:] = True
        done.append(leaves.take(settled))
        done_index.append(bound[settled])
        upper = max(upper, float(bound[settled].max(initial=0)))
        if settled.all():
            break
        leaves = path.halve(pairs, leaves.take(~settled))
    return Certified(
        upper=max(upper, best),
        attained=best,
        witnesses=found.witnesses(),
        violated=found.violated,
        leaves=Leaves.joined(done),
        leaf_index=np.concatenate(done_index),
    )


class _Found:
    """What the search met so far: per obstacle the highest index, per kind the deepest violation."""

    def __init__(self, pairs: Pairs) -> None:
        """Nothing was met yet."""
        self.pairs = pairs
        self.best = 0.0
        self.violated: dict[Kind, Witness] = {}
        self._by_obstacle: dict[int, Witness] = {}

    def at_rest(self, path: Route, rows: NDArray[np.intp]) -> None:
        """Note violations at both ends of the path, where the arm stands and no middle ever lies."""
        may = rows[np.isfinite(self.pairs.violated_below[rows])]
        if may.size:
            for key in (0, GRID):
                clearance = path.clearance_at(self.pairs, key, may)
                self._note_violations(np.full(len(may), key), may, clearance, np.zeros(len(may)))

    def look(self, leaves: Leaves, attained: Floats, speed: Floats) -> None:
        """Note what the middles of these rows attain."""
        if not len(leaves):
            return
        self.best = max(self.best, float(attained.max()))
        group = self.pairs.group[leaves.pair]
        order = np.lexsort((-leaves.clear_mid_m, attained))
        top = np.full(int(self.pairs.group.max()) + 1, -1)
        top[group[order]] = order  # of equal places the last assignment stays: the highest, and of those the nearest
        mid = leaves.mid
        for g in np.flatnonzero(top >= 0).tolist():
            row = int(top[g])
            known = self._by_obstacle.get(g)
            met = (float(attained[row]), -float(leaves.clear_mid_m[row]))
            if known is None or met > (known.index, -known.clearance_m):
                self._by_obstacle[g] = Witness(
                    int(mid[row]),
                    int(leaves.pair[row]),
                    float(attained[row]),
                    float(leaves.clear_mid_m[row]),
                    float(speed[row]),
                )
        self._note_violations(mid, leaves.pair, leaves.clear_mid_m, speed)

    def _note_violations(
        self, key: NDArray[np.int64], pair: NDArray[np.intp], clearance: Floats, speed: Floats
    ) -> None:
        below = clearance < self.pairs.violated_below[pair]
        for row in np.flatnonzero(below).tolist():
            kind = self.pairs.kind_of(int(pair[row]))
            known = self.violated.get(kind)
            if known is None or clearance[row] < known.clearance_m:
                self.violated[kind] = Witness(
                    int(key[row]), int(pair[row]), 0.0, float(clearance[row]), float(speed[row])
                )

    def doubtful(self, leaves: Leaves) -> NDArray[np.bool_]:
        """Rows that may hide a violation of a kind that was not met yet."""
        open_kinds = [k for k in VIOLABLE if k not in self.violated]
        may = np.isin(self.pairs.kind[leaves.pair], [self.pairs.code_of(k) for k in open_kinds])
        short = leaves.clear_m < self.pairs.violated_below[leaves.pair] - VIOLATION_RESOLUTION_M
        return np.asarray(may & short)

    def witnesses(self) -> tuple[Witness, ...]:
        """Highest first; among equals the nearest."""
        return tuple(sorted(self._by_obstacle.values(), key=lambda w: (-w.index, w.clearance_m, w.key)))


@dataclass(frozen=True, slots=True)
class Fit:
    """Whether an index was proven, and the leaves as far as they had to be halved; they hold for any profile."""

    leaves: Leaves
    proven: bool


def fits(
    path: Route,
    pairs: Pairs,
    profile: Profile,
    stop: Stopping,
    leaves: Leaves,
    *,
    index: float,
    check_time: Callable[[], None],
) -> Fit:
    """Whether it is proven that no row exceeds `index` at this profile.

    "Not proven" may also mean that `LOWER_DEPTH` halvings did not suffice to prove it: the caller then names a slower
    speed, never a faster.
    """
    kept: list[Leaves] = []
    for depth in range(LOWER_DEPTH + 1):
        check_time()
        low, high, mid = leaves.low / GRID, leaves.high / GRID, leaves.mid / GRID
        bound = pairs.index(leaves.pair, leaves.clear_m, leaves.rush * profile.highest_rate(low, high), stop)
        attained = pairs.index(leaves.pair, leaves.clear_mid_m, leaves.rush_mid * profile.rate(mid), stop)
        over = bound > index + TIE
        if not over.any() or depth == LOWER_DEPTH or (attained > index + TIE).any():
            return Fit(Leaves.joined([*kept, leaves]), proven=not over.any())
        kept.append(leaves.take(~over))
        leaves = path.halve(pairs, leaves.take(over))
    raise AssertionError("the last depth returns")

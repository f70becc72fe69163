"""Branch and bound on the index in numpy, as the kernel answers it: the slow twin of its searches."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from pep.pit.base.errors import WorkLimitError
from pep.pit.base.tier import HIGHEST, TIE, tier_of
from pep.pit.path.path import Leaves
from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import VIOLABLE, PairKind
from pep.pit.search.certify import (
    BLOW_DEPTH,
    BLOW_RESOLUTION,
    DEPTH,
    LOWER_DEPTH,
    RESOLUTION,
    ROWS_MOST,
    VIOLATION_RESOLUTION_M,
    Certified,
    Fit,
    Witness,
    cut,
    first_cut,
    refuse_hidden,
)
from pep.pit.search.speed_bisection import highest_speed

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from pep.pit.base.motion import Floats, Profile
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Route
    from pep.pit.scene.pairs import Pairs
    from pep.pit.search.certify import Slower


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
    slower: Slower | None = None,
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
    found_all = Certified(
        upper=max(upper, best),
        attained=best,
        witnesses=found.witnesses(),
        violated=found.violated,
        leaves=Leaves.joined(done),
        leaf_index=np.concatenate(done_index),
    )
    refuse_hidden(pairs, found_all)
    if slower is None:
        return found_all
    return replace(found_all, slower=_slower(path, pairs, profile, stop, found_all, slower, check_time))


def _slower(path, pairs, profile, stop, certified, slower, check_time):
    """Highest commanded speed, to a bisection step, at which the index is proven a tier lower."""
    target = float(tier_of(min(certified.upper, HIGHEST)) - 1)
    leaves = certified.leaves.take(certified.leaf_index > target)

    def falls(speed):
        nonlocal leaves
        timing = replace(profile, speed_rad_s=speed)
        ramp = timing.peak_rad_s / slower.stop_deceleration_rad_s2
        stops = replace(stop, brake_s=slower.stop_delay_s + ramp, travel_s=slower.stop_delay_s + 0.5 * ramp)
        fit = fits(path, pairs, timing, stops, leaves, index=target, check_time=check_time)
        leaves = fit.leaves
        return fit.proven

    return highest_speed(falls, slowest=slower.slowest_rad_s, fastest=slower.commanded_rad_s)


class _Found:
    """Findings of the search so far: per obstacle the highest index, per kind the deepest violation."""

    def __init__(self, pairs: Pairs) -> None:
        """Nothing was met yet."""
        self.pairs = pairs
        self.best = 0.0
        self.violated: dict[PairKind, Witness] = {}
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
    """Fit that is proven where no row exceeds `index` at this profile.

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


def blow_ratio(path: Route, pairs: Pairs, profile: Profile, stop: Stopping, *, check_time: Callable[[], None]) -> float:
    """Proven bound on the share of its limit speed at which the arm could meet any body region."""
    rows = np.flatnonzero(pairs.kind == pairs.code_of(PairKind.PERSON))
    if not rows.size:
        return 0.0
    leaves = first_cut(path, pairs, rows)
    proven = best = 0.0
    for depth in range(BLOW_DEPTH + 1):
        check_time()
        mid = leaves.mid / GRID
        attained = _ratio(pairs, leaves.pair, leaves.clear_mid_m, leaves.rush_mid * profile.rate(mid), stop)
        rate = profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
        bound = _ratio(pairs, leaves.pair, leaves.clear_m, leaves.rush * rate, stop)
        best = max(best, float(attained.max()))
        wide = (bound > max(proven, best) + BLOW_RESOLUTION) if depth < BLOW_DEPTH else np.zeros(len(bound), dtype=bool)
        proven = max(proven, float(bound[~wide].max(initial=0.0)))
        if not wide.any():
            break
        leaves = path.halve(pairs, leaves.take(wide))
    return proven


def _ratio(pairs: Pairs, rows: NDArray[np.intp], clearance: Floats, speed: Floats, stop: Stopping) -> Floats:
    protective = stop.approach_m(pairs.intrusion[rows]) + stop.travel_m(speed)
    possible = clearance - pairs.uncertainty[rows] < protective
    return np.asarray(np.where(possible, speed / pairs.limit_speed[rows], 0.0))

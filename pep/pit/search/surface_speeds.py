"""Proven highest speeds of a robot's points over a whole straight path, on intervals as short as the answer needs.

Where a speed, or a sum of masses times speeds, comes near its limit, a bound on coarse intervals alone would decide.
There the intervals that hold the bound up are halved until it is within `INDEX_WITHIN` of what the nodes attain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.tier import BUSY_BAND, CALM_RATIO, ratio_index, tier_of
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.certify import DEPTH, cut

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile
    from pep.pit.path.path import Keys
    from pep.pit.path.straight_path import Path

FINER: Final = 2  # halves of the first cut to begin with: a quarter of the slack
INDEX_WITHIN: Final = 0.005  # PHY-7: of the index of a ratio, between what is proven and what is attained
RATIO_WITHIN: Final = (
    0.5 * INDEX_WITHIN * BUSY_BAND
)  # the same of one ratio where its index is steepest, and half of it
CUTS_MOST: Final = 1024  # intervals of one path; with more the bound stays as it is, which is still one


@dataclass(frozen=True, slots=True, eq=False)
class Speeds:
    """Bounds on speeds, interval by interval.

    Attributes:
        low, high: intervals that tile the path in order, in GRID units, (n,).
        rush: proven: surface speed of each body per unit of ds/dt is at most this there, (n, bodies), metre.
        most_m_s: proven: surface speed of each body on the whole path is at most this, (bodies,).
    """

    low: Keys
    high: Keys
    rush: Floats
    most_m_s: Floats


class Intervals:
    """The intervals of one path to begin with, and what any profile makes of them."""

    def __init__(self, path: Path, shares: Floats) -> None:
        """Bounds on equal intervals.

        Args:
            path: whose bodies move.
            shares: per quantity and body, the part of the quantity's limit that the body has per m/s, (quantities,
                bodies), 1/(m/s); only bodies that are points have any.
        """
        self._path, self._shares = path, shares
        low, high = cut(path)
        step = int((high - low)[0]) // FINER
        self.low = np.arange(0, GRID, step, dtype=np.int64)
        self._high = self.low + step
        self.node_s = np.append(self.low, GRID) / GRID
        self._rush = path.rush(self.low, self._high)
        self._least = step >> DEPTH
        self._last: tuple[Profile, Floats, Speeds] | None = None

    def speeds(self, profile: Profile) -> Speeds:
        """The speeds under this profile; ratios near a limit within `INDEX_WITHIN` of what is attained."""
        return self._found(profile)[2]

    def rates(self, profile: Profile) -> Floats:
        """ds/dt at the ends of the equal intervals (`node_s`), 1/s."""
        return self._found(profile)[1]

    def _found(self, profile: Profile) -> tuple[Profile, Floats, Speeds]:
        if self._last is None or self._last[0] != profile:
            rates = profile.rate(self.node_s)
            self._last = profile, rates, self._settled(profile, rates)
        return self._last

    def _settled(self, profile: Profile, rates: Floats) -> Speeds:
        low, high, rush, top = self.low, self._high, self._rush, profile.top
        # As `Profile.highest_rate`: where the top is outside, the rate is highest at the end that is nearer to it.
        spanned = (self.node_s[:-1] <= top) & (top <= self.node_s[1:])
        fastest = np.where(spanned, profile.peak_rad_s / profile.way_rad, np.maximum(rates[:-1], rates[1:]))
        while True:
            bound = rush * fastest[:, None]
            most = np.asarray(bound.max(axis=0))
            found = Speeds(low, high, rush, most)
            if not (self._shares @ most > CALM_RATIO).any():
                return found
            met = self._attained(low, high, rush, profile).max(axis=0)
            split = (bound > met + self._slack(most, met)).any(axis=1) & (high - low > self._least)
            if not split.any() or len(low) + int(split.sum()) > CUTS_MOST:
                return found
            mid = (low[split] + high[split]) // 2
            halves = np.concatenate([low[split], mid]), np.concatenate([mid, high[split]])
            parts = (
                np.concatenate([low[~split], halves[0]]),
                np.concatenate([high[~split], halves[1]]),
                np.concatenate([rush[~split], self._path.rush(*halves)]),
            )
            order = np.argsort(parts[0])
            low, high, rush = parts[0][order], parts[1][order], parts[2][order]
            fastest = profile.highest_rate(low / GRID, high / GRID)

    def _attained(self, low: Keys, high: Keys, rush: Floats, profile: Profile) -> Floats:
        """Speeds that points reach on each interval, (n, bodies): the fastest node's, at the slower end's rate.

        The rate rises once and falls once, so nowhere on an interval is it less than at both of its ends.
        """
        slower = np.minimum(profile.rate(low / GRID), profile.rate(high / GRID))
        bend = (((high - low) / GRID) ** 2)[:, None] / CHORD
        return np.asarray((rush - self._path.bending.third * bend) * slower[:, None])

    def _slack(self, most: Floats, met: Floats) -> Floats:
        """By how much each body's bound may exceed what is met, m/s: endlessly where no open quantity depends on it."""
        slack = np.full(len(most), np.inf)
        for share in self._shares:
            upper, lower = float(share @ most), float(share @ met)
            if not upper > CALM_RATIO:
                continue
            above, below = ratio_index(upper), ratio_index(lower)
            bodies: NDArray[np.bool_] = share > 0
            if above - below > INDEX_WITHIN and tier_of(above) == tier_of(below):
                slack[bodies] = np.minimum(slack[bodies], RATIO_WITHIN / float(share.sum()))
            elif tier_of(above) != tier_of(below):
                slack[bodies] = 0.0
        return slack

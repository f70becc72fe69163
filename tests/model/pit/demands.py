"""Speeds, momentum and torque of a straight move in numpy: the slow twin of `pep.pit.search.kernel.compiled_limits`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np
from pep.pit.base.motion import profile_of
from pep.pit.base.tier import CALM_RATIO, ratio_index, tier_of
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.arm_limits import Ratio, body_ratios, speed_shares
from pep.pit.search.certify import DEPTH, cut
from pep.pit.search.speed_bisection import highest_speed
from pep.pit.search.surface_speeds import CUTS_MOST, FINER, INDEX_WITHIN, RATIO_WITHIN
from pep.pit.search.torques import Torques

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray
    from pep.pit.base.motion import Floats, Profile, Run
    from pep.pit.path.path import Keys
    from pep.pit.path.straight_path import Path
    from pep.pit.scene.cell import CellParameters


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


class Demands:
    """Loads of a move: the parts without its timing, computed once, then ratios for any profile."""

    def __init__(self, path: Path, cell: CellParameters) -> None:
        """Torque and speed terms at the path's nodes."""
        self._robot, self._cell = path.robot, cell
        self._intervals = Intervals(path, speed_shares(path.robot, cell))
        self._ways = np.abs(path.delta).tolist()
        self._limits = path.robot.speed_limits_rad_s.tolist()
        q = path.start + self._intervals.node_s[:, None] * path.delta
        self._torques = Torques(path.robot, cell, q, np.repeat(path.delta[None], len(q), axis=0), np.zeros_like(q))

    def speeds(self, profile: Profile) -> Speeds:
        """Proven bounds on the surface speed of every body, and the intervals on which they are proven."""
        return self._intervals.speeds(profile)

    def surface_speed_m_s(self, profile: Profile) -> Floats:
        """Proven bound on the surface speed of every body of the robot over the whole path, shape (bodies,)."""
        return self.speeds(profile).most_m_s

    def ratios(self, profile: Profile) -> tuple[Ratio, ...]:
        """Every quantity of this move under this profile against its limit."""
        return tuple(self._each(profile))

    def at_most(self, profile: Profile, index: float) -> bool:
        """True where no ratio has a higher index; the dearest are computed only where the others have none."""
        return all(ratio.index <= index for ratio in self._each(profile))

    def fastest(self, move: Run, index: float, *, slowest: float, check_time: Callable[[], None]) -> float | None:
        """The highest commanded speed, to a step of the bisection, at which no ratio's index is above `index`.

        Args:
            move: at the commanded speed, at which some ratio's is.
            index: what none may exceed.
            slowest: a slower one is of no use, rad/s.
            check_time: raises when the answer would come too late.
        """

        def falls(speed: float) -> bool:
            check_time()
            profile = profile_of(move, speed)
            return profile is not None and self.at_most(profile, index)

        return highest_speed(falls, slowest=slowest, fastest=move.speed_rad_s)

    def _each(self, profile: Profile) -> Iterator[Ratio]:
        robot = self._robot
        shares = [way / profile.way_rad for way in self._ways]
        asked = max(map(_by_limit, shares, repeat(profile.speed_rad_s), self._limits))
        joint = max(map(_by_limit, shares, repeat(profile.peak_rad_s), self._limits))
        # A short move never reaches a forbidden speed, but asking for one is asking to break the limit.
        yield Ratio("joint_speed", asked if asked > 1 else joint)
        yield Ratio("acceleration", profile.acceleration_rad_s2 / robot.model.acceleration_limit_rad_s2)
        speeds = self.surface_speed_m_s(profile)
        tool = float(speeds[robot.body_index("tcp")])
        yield from body_ratios(robot, self._cell, speeds, tool_speed_m_s=tool, torque=lambda: self._torque(profile))

    def _torque(self, profile: Profile) -> float:
        return self._torques.ratio(
            self._intervals.rates(profile),
            forward=profile.acceleration_rad_s2 / profile.way_rad,
            backward=profile.braking_rad_s2 / profile.way_rad,
        )


def _by_limit(share: float, speed: float, limit: float) -> float:
    return share * speed / limit

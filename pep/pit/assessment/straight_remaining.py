"""Rest of one running motion: judged at any fraction of its speed, to its end or briefly.

Only the way from the arm's measured place counts, with the rates that the motion's own profile can still have there.
Each question is left as soon as its answer is certain; a yes has a proof, found on the same intervals as a verdict's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from pep.pit.assessment.assessment import milli
from pep.pit.base.errors import UnprovenError, WorkLimitError
from pep.pit.base.motion import STILL_RAD, profile_of
from pep.pit.base.tier import HIGHEST, MOVING, TIE
from pep.pit.geometry.clearance import ROUNDING_M
from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import VIOLABLE
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import DEPTH, ROWS_MOST, VIOLATION_RESOLUTION_M, first_cut
from pep.pit.search.engine import chosen
from pep.pit.search.meant_contact import gentle_rows
from pep.pit.search.question import view_around
from pep.pit.search.start_violations import RETREAT, departure, joint_limits, slow_enough

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Joints, Profile, Run
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Leaves, Route
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene
    from pep.pit.scene.view import View
    from pep.pit.search.start_violations import JointLimits

PER_MILLI: Final = 1e-3  # index by index_milli
FULL: Final = 1.0  # the commanded speed, as a fraction of itself
OFF_PATH: Final = "off_path"
MOVES: Final = "motion"
PERCEPTION: Final = "perception"
JOINT_LIMIT: Final = "joint_limit"
RETREATS: Final = "retreat"


@dataclass(frozen=True, slots=True)
class Pace:
    """Speed at which the rest is proven to be inside the authorised index.

    Attributes:
        fraction: of the commanded speed, above 0 and at most 1.
        index_milli: proven index of what is left at that speed, and until it is reached.
    """

    fraction: float
    index_milli: int


@dataclass(frozen=True, slots=True)
class Remaining:
    """Judgement of the rest of a motion.

    Attributes:
        holds: it is, at the speed that was asked about. Otherwise the arm must slow down to `pace` at once, or stop.
        index_milli: when it holds, the proven index of what is left; otherwise the index that was met or could not be
            excluded.
        cause: "" when it holds; otherwise the kind of contribution or violation that speaks against it, or "off_path".
        pace: the highest speed, in steps of the slider, at which it is proven: at least the one asked about when that
            holds, else a lower one that the arm may take up from the one asked about. None when there is none, and
            when it was not asked for.
    """

    holds: bool
    index_milli: int
    cause: str
    pace: Pace | None = None


class RemainingMotion(Protocol):
    """Rest of a motion whose timing the speed slider stretches."""

    check_time: Callable[[], None]

    def prepare(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining | None:
        """Computes all that does not depend on the speed; the answer, when it is already certain."""
        ...

    def at(self, fraction: float) -> Remaining:
        """Judges all of the rest at this fraction of the commanded speed. After `prepare` has said None."""
        ...

    def near(self, fraction: float, seconds: float) -> Remaining:
        """Judges the part in reach within so many seconds at this fraction. After `prepare` has said None."""
        ...


def against(authorised_milli: int, index_milli: int, cause: str) -> Remaining:
    """Judgement of that index against the authorised one, with the cause where it is above."""
    holds = index_milli <= authorised_milli
    return Remaining(holds, index_milli, "" if holds else cause)


def strays_m(robot: Robot, error_rad: Floats) -> float:
    """Bound on the way of any part of the robot when joint angles are off by this much."""
    return float((robot.reach @ np.abs(error_rad)).max())


def slowed(profile: Profile, fraction: float) -> Profile:
    """The profile with its time stretched: each rate times `fraction`, so accelerations times its square."""
    if fraction == FULL:
        return profile
    return replace(
        profile,
        speed_rad_s=profile.speed_rad_s * fraction,
        acceleration_rad_s2=profile.acceleration_rad_s2 * fraction**2,
        braking_rad_s2=profile.braking_rad_s2 * fraction**2,
    )


def reached_key(since: int, profile: Profile, seconds: float) -> int:
    """Place (in 1 / GRID) that the motion does not pass within so many seconds after `since`."""
    farther = math.ceil(seconds * profile.peak_rad_s / profile.way_rad * GRID)
    return min(since + farther, GRID)


class RemainingRun:
    """Rest of one run, from the arm's place."""

    def __init__(
        self,
        robot: Robot,
        run: Run,
        cell: CellParameters,
        *,
        at_rad: Joints,
        authorised_milli: int,
        check_time: Callable[[], None],
    ) -> None:
        self.robot, self.run, self.cell, self.at_rad = robot, run, cell, at_rad
        self.authorised_milli, self.check_time = authorised_milli, check_time
        self.limit = authorised_milli * PER_MILLI + TIE
        self.since = 0
        self.profile: Profile
        self.view: View
        self.bare: Pairs

    def prepare(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining | None:
        """Takes the steps that do not depend on the speed, in order."""
        run, cell = self.run, self.cell
        engine = chosen()
        self.path = path = engine.path(self.robot, run)
        # 1. Where on the path the arm is. What lies behind it is done.
        at = np.array(self.at_rad)
        length2 = float(path.delta @ path.delta)
        s = float(np.clip((at - path.start) @ path.delta / length2, 0, 1)) if length2 > STILL_RAD**2 else 0.0
        if not strays_m(self.robot, at - path.q(s)) <= cell.tracking_tolerance_m:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
        profile = profile_of(run)
        if profile is None:
            return Remaining(holds=True, index_milli=0, cause="")
        self.profile, self.since = profile, int(s * GRID)
        self.limits = joint_limits(self.robot, path.q(s).tolist(), run.target)
        if self.limits.broken:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=JOINT_LIMIT)
        self.demands = engine.demands(path, cell)
        # 2. The view, without the held object, wherever it was seen on the way here, at any speed.
        speeds = self.demands.surface_speed_m_s(profile)
        self.look_around(scene, age_s, touch, speeds)
        return None

    def look_around(self, scene: Scene | None, age_s: float | None, touch: frozenset[str], speeds: Floats) -> None:
        """Takes in the view and its pairs; `speeds` bound those of the bodies since it was taken."""
        lag_m = float(speeds.max()) * (age_s or 0.0)
        self.view = view_around(self.robot, scene, age_s, self.at_rad, self.cell, lag_m=lag_m)
        self.bare = pairs_of(self.robot, self.view.scene, self.cell, grown_m=self.view.grown_m, touch=touch)

    def at(self, fraction: float) -> Remaining:
        """Judges all of the rest at this fraction of the commanded speed."""
        return self._ask(slowed(self.profile, fraction), fraction, GRID)

    def near(self, fraction: float, seconds: float) -> Remaining:
        """Judges the part in reach within so many seconds at this fraction."""
        return self._ask(slowed(self.profile, fraction), fraction, self.until(fraction, seconds))

    def until(self, fraction: float, seconds: float) -> int:
        """Place (in 1 / GRID) that the arm does not pass within so many seconds at this fraction."""
        return reached_key(self.since, slowed(self.profile, fraction), seconds)

    def _ask(self, profile: Profile, fraction: float, until: int) -> Remaining:
        """Judges the rest up to `until` at this fraction, whose profile is given."""
        del fraction  # all that a run asks of the arm follows from the profile
        ratios = ((ratio.index, ratio.name) for ratio in self.demands.ratios(profile))
        speeds = self.demands.surface_speed_m_s(profile)
        return self.judge(
            self.path,
            profile,
            floors=[(MOVING, MOVES), *ratios],
            speeds=speeds,
            joint_speed_rad_s=profile.peak_rad_s,
            limits=self.limits,
            until=until,
        )

    def judge(
        self,
        path: Route,
        profile: Profile,
        *,
        floors: list[tuple[float, str]],
        speeds: Floats,
        joint_speed_rad_s: float,
        limits: JointLimits | None,
        until: int,
    ) -> Remaining:
        """Takes the steps that depend on the speed, in order."""
        cell, since, view = self.cell, self.since, self.view
        pairs = self.bare.meant(gentle_rows(path, self.bare, profile, cell, since=since, check_time=self.check_time))
        # 3. What is violated where the arm is, and whether the rest only leads away from it.
        surface = float(speeds[: self.robot.world_bodies].max())
        slow = slow_enough(cell, joint_speed_rad_s=joint_speed_rad_s, speed_m_s=surface)
        here = departure(path, pairs, cell, slow=slow, since=since)
        retreating = limits is not None and limits.retreating
        if retreating and not slow:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=JOINT_LIMIT)
        floors = [*floors, (view.floor, PERCEPTION)]
        if retreating or here.retreating.size:
            floors.append((RETREAT, RETREATS))
        # 4. Floors that hold for all surroundings.
        floor, cause = max(floors)
        if not milli(floor) <= self.authorised_milli:
            return Remaining(holds=False, index_milli=milli(floor), cause=cause)
        # 5. The proof that no pair exceeds the authorised index.
        stop = stopping(cell, perception_age_s=view.stopping_age_s, joint_speed_rad_s=joint_speed_rad_s)
        return self._proof(path, pairs, profile, stop, rows=here.rows, speeds=speeds, floor=floor, until=until)

    def _proof(
        self,
        path: Route,
        pairs: Pairs,
        profile: Profile,
        stop: Stopping,
        *,
        rows: NDArray[np.intp],
        speeds: Floats,
        floor: float,
        until: int,
    ) -> Remaining:
        """Searches as `certify` does with the answer known beforehand.

        Each row is followed until it is at most that.
        """
        since = self.since
        for key in (since, until):
            clearance = path.clearance_at(pairs, key, rows)
            speed = path.rush_at(pairs, key, rows) * profile.rate(np.array(key / GRID))
            met = self._met(pairs, rows, clearance, pairs.index(rows, clearance, speed, stop))
            if met is not None:
                return met
        rows, proven = self._far_enough(path, pairs, stop, rows=rows, speeds=speeds, until=until)
        proven = max(proven, floor)
        if since >= until or not rows.size:
            return Remaining(holds=True, index_milli=milli(proven), cause="")
        leaves = _before(first_cut(path, pairs, rows, since=since), until)
        examined = 0
        for depth in range(DEPTH + 1):
            self.check_time()
            examined += len(leaves)
            if examined > ROWS_MOST:
                raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
            mid = leaves.mid
            ahead = leaves.take((mid >= since) & (mid <= until))
            attained = pairs.index(ahead.pair, ahead.clear_mid_m, ahead.rush_mid * profile.rate(ahead.mid / GRID), stop)
            met = self._met(pairs, ahead.pair, ahead.clear_mid_m, attained)
            if met is not None:
                return met
            rate = profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
            bound = pairs.index(leaves.pair, leaves.clear_m, leaves.rush * rate, stop)
            over = bound > self.limit
            if depth == DEPTH:
                if over.any():
                    worst = int(bound.argmax())
                    return _not(pairs, int(leaves.pair[worst]), float(bound[worst]))
                if _doubtful(pairs, leaves).any():
                    raise UnprovenError("violation")
                return Remaining(holds=True, index_milli=milli(max(proven, float(bound.max()))), cause="")
            unsettled = over | _doubtful(pairs, leaves)
            proven = max(proven, float(bound[~unsettled].max(initial=0)))
            if not unsettled.any():
                return Remaining(holds=True, index_milli=milli(proven), cause="")
            leaves = _before(path.halve(pairs, leaves.take(unsettled), since=since), until)
        raise AssertionError("the last depth returns")

    def strays_m(self, middle: int, until: int) -> Floats:
        """Way of each body between `middle` and either end of the judged part, at most, (bodies,)."""
        return np.asarray(self.robot.reach @ np.abs(self.path.delta) * ((until - middle) / GRID))

    def _far_enough(
        self, path: Route, pairs: Pairs, stop: Stopping, *, rows: NDArray[np.intp], speeds: Floats, until: int
    ) -> tuple[NDArray[np.intp], float]:
        """Pairs that one look at the middle of the rest leaves open, and the index of the others.

        From the middle no part goes farther than its levers times the joints' ways, nor faster than on the whole path.
        """
        middle = (self.since + until) // 2  # rounded down: the farther end is `until`
        body = pairs.body[rows]
        clearance = path.clearance_at(pairs, middle, rows) - self.strays_m(middle, until)[body] - ROUNDING_M
        bound = pairs.index(rows, clearance, speeds[body], stop)
        settled = (bound <= self.limit) & ~(clearance < pairs.violated_below[rows])
        return rows[~settled], float(bound[settled].max(initial=0))

    def _met(self, pairs: Pairs, rows: NDArray[np.intp], clearance: Floats, index: Floats) -> Remaining | None:
        """Forbidden finding there: a violation, or an index above the authorised one; None without one."""
        below = clearance < pairs.violated_below[rows]
        if below.any():
            kind = pairs.kind_of(int(rows[int(np.flatnonzero(below)[0])]))
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=str(kind))
        worst = int(index.argmax()) if len(index) else -1
        if worst < 0 or index[worst] <= self.limit:
            return None
        return _not(pairs, int(rows[worst]), float(index[worst]))


def _not(pairs: Pairs, pair: int, index: float) -> Remaining:
    """Negative judgement because of this pair."""
    return Remaining(holds=False, index_milli=milli(min(index, HIGHEST)), cause=str(pairs.kind_of(pair)))


def _before(leaves: Leaves, until: int) -> Leaves:
    """Rows without those that begin behind `until`."""
    return leaves if until >= GRID else leaves.take(leaves.low < until)


def _doubtful(pairs: Pairs, leaves: Leaves) -> NDArray[np.bool_]:
    """Rows that may hide a violation."""
    may = np.isin(pairs.kind[leaves.pair], [pairs.code_of(kind) for kind in VIOLABLE])
    return np.asarray(may & (leaves.clear_m < pairs.violated_below[leaves.pair] - VIOLATION_RESOLUTION_M))

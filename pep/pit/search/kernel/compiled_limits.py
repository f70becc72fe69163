"""Compiled engine's answer to the demands of a straight joint move on the arm."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.errors import WorkLimitError
from pep.pit.base.motion import Run, profile_of
from pep.pit.base.tier import HIGHEST, MOVING
from pep.pit.path.straight_path import GRID
from pep.pit.robot.robot import Robot
from pep.pit.scene.cell import CellParameters
from pep.pit.search.arm_limits import Ratio, carried_ratio, speed_shares
from pep.pit.search.certify import cuts
from pep.pit.search.kernel.compiled_path import CompiledPath, blocks
from pep.pit.search.kernel.loads import QUANTITIES, laid_out, under
from pep.pit.search.kernel.search_columns import NOBODY
from pep.pit.search.surface_speeds import FINER
from pep.pit.search.torques import carried_kg, masses_with

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile
    from pep.pit.path.path import Keys
    from pep.pit.path.straight_path import Path


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def _limits_of(robot: Robot, cell: CellParameters) -> Floats:
    arm = [robot.model.acceleration_limit_rad_s2, cell.tcp_speed_limit_m_s, carried_ratio(robot, cell)]
    return np.concatenate([robot.speed_limits_rad_s, robot.torque_limits_nm, arm])


@lru_cache(maxsize=64)  # likewise
def _shares_of(robot: Robot, cell: CellParameters) -> Floats:
    return speed_shares(robot, cell).copy()  # numba compiles anew for a read-only array


@lru_cache(maxsize=16)  # as many as there are powers of two
def _edges(count: int) -> NDArray[np.int64]:
    """Ends of so many equal intervals."""
    return np.arange(count + 1, dtype=np.int64) * (GRID // count)


class Demands:
    """Demands of a move: parts without its timing, computed once, and ratios for any profile."""

    def __init__(self, path: Path, cell: CellParameters) -> None:
        """Computes torque and speed terms at the path's nodes."""
        robot, asked = path.robot, np.concatenate([path.start, path.delta])
        arm, edges = blocks(robot), _edges(FINER * cuts(path))
        found = laid_out(*arm, masses_with(robot, carried_kg(robot, cell)), asked, edges)
        self._known = *arm, asked, _shares_of(robot, cell), _limits_of(robot, cell), *found
        self._last: tuple[Profile, Floats, Floats, Keys, Keys] | None = None

    def surface_speed_m_s(self, profile: Profile) -> Floats:
        """Proven bound on the surface speed of every body of the robot over the whole path, shape (bodies,)."""
        return self._found(profile)[2]

    def intervals(self, profile: Profile) -> tuple[Keys, Keys]:
        """Ends of the intervals on which these speeds are proven, in order, in 1 / GRID, (n,) each."""
        _, _, _, low, high = self._found(profile)
        if not len(low):
            edges = _edges(len(self._known[5]))  # the equal ones, of which the speeds per unit of ds/dt are known
            return edges[:-1], edges[1:]
        order = np.argsort(low)
        return low[order], high[order]

    def ratios(self, profile: Profile) -> tuple[Ratio, ...]:
        """Every quantity of this move under this profile against its limit."""
        return tuple(map(Ratio, QUANTITIES, self._found(profile)[1].tolist()))

    def at_most(self, profile: Profile, index: float) -> bool:
        """True where no ratio has a higher index."""
        return all(ratio.index <= index for ratio in self.ratios(profile))

    def fastest(self, move: Run, index: float, *, slowest: float, check_time: Callable[[], None]) -> float | None:
        """The highest commanded speed, to a step of the bisection, at which no ratio's index is above `index`.

        Args:
            move: at the commanded speed, at which some ratio's is.
            index: index that none may exceed.
            slowest: a slower one is of no use, rad/s.
            check_time: raises when the answer would come too late; asked once, all takes less than one look elsewhere.
        """
        try:
            check_time()
        except WorkLimitError:
            return None
        profile = profile_of(move)
        if profile is None or not profile.speed_rad_s > slowest:
            return None
        found = under(*self._known, _timing(profile), float(slowest), float(index))[-1]
        return None if found == NOBODY else float(found)

    def _found(self, profile: Profile) -> tuple[Profile, Floats, Floats, Keys, Keys]:
        if self._last is None or self._last[0] != profile:
            # At no slower speed than its own: there is none to look for.
            ratios, most, low, high, _ = under(*self._known, _timing(profile), float(profile.speed_rad_s), HIGHEST)
            self._last = profile, ratios, most, low, high
        return self._last


def _timing(profile: Profile) -> Floats:
    numbers = profile.way_rad, profile.speed_rad_s, profile.acceleration_rad_s2, profile.braking_rad_s2
    return np.array(numbers, dtype=np.float64)


def compile_all() -> None:
    """Compiles every entry, or reads it from disk."""
    robot, cell = Robot.load("ur3e"), CellParameters()
    start = (0.0, -1.5, 1.5, -1.5, -1.5, 0.0)
    run = Run(start, (0.4, *start[1:]), 0.5, 1.4, 1.4)
    profile = profile_of(run)
    if profile is None:
        raise AssertionError("the move goes somewhere")
    demands = Demands(CompiledPath(robot, run), cell)
    demands.ratios(profile)
    demands.fastest(run, MOVING, slowest=profile.speed_rad_s / 2, check_time=_no_limit)


def _no_limit() -> None:
    """Ends at no time: the time is not counted."""

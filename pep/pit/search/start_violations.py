"""Violations at the start of a motion, and motions that only lead away from them.

A stuck arm must be able to retreat: from beyond a joint limit, or from a forbidden contact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.path.straight_path import GRID

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.path.path import Route
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.obstacles import PairKind
    from pep.pit.scene.pairs import Pairs

RETREAT: Final = 3.0  # PHY-6: index of a stuck arm's retreat
RETREAT_CUT: Final = 128  # equal intervals in the proof that nothing comes nearer


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Relation of a move to the joint limits: it breaks one (and which), or it comes back from beyond."""

    broken: bool
    retreating: bool
    joint: str


def joint_limits(robot: Robot, start: Iterable[float], target: Iterable[float]) -> JointLimits:
    """Relation of a move between these joint angles (rad) to the limits."""
    before, after = robot.beyond_rad(start), robot.beyond_rad(target)
    # From beyond one limit to beyond the other is no retreat, however the two excesses compare.
    worse = [not (abs(then) <= abs(now) and now * then >= 0) for now, then in zip(before, after, strict=True)]
    joint = robot.model.joints[worse.index(True) if any(worse) else 0].name
    return JointLimits(broken=any(worse), retreating=any(before), joint=joint)


def slow_enough(cell: CellParameters, *, joint_speed_rad_s: float, speed_m_s: float) -> bool:
    """True where a motion with these highest joint and surface speeds may be a retreat."""
    return joint_speed_rad_s <= cell.retreat_joint_speed_rad_s and speed_m_s <= cell.retreat_speed_m_s


@dataclass(frozen=True, slots=True)
class Departure:
    """Violations at the arm's place.

    Attributes:
        rows: pairs that the search asks about.
        retreating: pairs that are violated and proven never to come nearer.
    """

    rows: NDArray[np.intp]
    retreating: NDArray[np.intp]


def departure(path: Route, pairs: Pairs, cell: CellParameters, *, slow: bool, since: int = 0) -> Departure:
    """Violations at `since` (in 1 / GRID), and those that a slow motion leads away from."""
    rows = np.arange(len(pairs))
    may = rows[np.isfinite(pairs.violated_below)]
    violated = may[path.clearance_at(pairs, since, may) < pairs.violated_below[may]]
    if not violated.size or not slow or since >= GRID:
        return Departure(rows, violated[:0])
    nearer = _approaching(path, pairs, violated, tolerance_m=cell.retreat_tolerance_m, since=since)
    retreating = np.setdiff1d(violated, nearer)
    return Departure(np.setdiff1d(rows, retreating), retreating)


def violated_at_rest(pairs: Pairs, clearance_m: Floats) -> dict[PairKind, int]:
    """Per kind that is violated while the arm has these clearances (pairs,), the pair that is deepest in it."""
    depth = np.where(np.isfinite(pairs.violated_below), clearance_m - pairs.violated_below, np.inf)
    found: dict[PairKind, int] = {}
    for pair in np.argsort(depth, kind="stable").tolist():
        if not depth[pair] < 0:
            break
        found.setdefault(pairs.kind_of(pair), pair)
    return found


def _approaching(
    path: Route, pairs: Pairs, rows: NDArray[np.intp], *, tolerance_m: float, since: int
) -> NDArray[np.intp]:
    """Violated pairs whose clearance is not proven never to shrink.

    Proven means: on each interval the clearance stays within `tolerance_m` of the best reached before, or of the pair's
    own bound once that was reached.
    """
    edges = np.arange(RETREAT_CUT + 1, dtype=np.int64) * (GRID // RETREAT_CUT)
    low, high = edges[:-1], edges[1:]
    low, high = low[high > since], high[high > since]
    count = len(low)
    intervals = np.tile(low, len(rows)), np.tile(high, len(rows)), np.repeat(rows, count)
    proven = path.examine(pairs, *intervals).clear_m.reshape(len(rows), count)
    reached = np.stack([path.clearance_at(pairs, key, rows) for key in low.tolist()], axis=1)
    best = np.minimum(np.maximum.accumulate(reached, axis=1), pairs.violated_below[rows, None])
    kept = (proven >= best - tolerance_m).all(axis=1)
    return rows[~kept]

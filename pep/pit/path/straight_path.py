"""A straight joint path with its configurations computed once each, and rows of (interval, pair) examined on it.

Path parameters are whole multiples of 1 / GRID, so that halving an interval is exact and every configuration has one
name.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.geometry.clearance import core_distance, interval_clearance
from pep.pit.path.path import Leaves, Route
from pep.pit.robot.kinematics import Poses, bending, layout, poses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Straight
    from pep.pit.path.path import Keys
    from pep.pit.robot.kinematics import Bending
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.pairs import Pairs

GRID: Final = 2**24  # 6 bits for the first cut, 14 for halvings, 1 for midpoints, 3 to spare
CHORD: Final = 32  # 1 / (8 * 2^2): the chord lemma's h^2 / 8 with a third node in the middle


class Path(Route):
    """A joint move's path for one robot. Holds every configuration it was asked for; not shared between threads."""

    def __init__(self, robot: Robot, move: Straight) -> None:
        """A path that holds no configuration yet."""
        self.robot, self.layout, self._move = robot, layout(robot), move
        self._known: dict[int, int] = {}
        self._poses: Poses | None = None

    @cached_property
    def start(self) -> Floats:
        """Joint angles where it starts, rad."""
        return np.array(self._move.start)

    @cached_property
    def delta(self) -> Floats:  # type: ignore[override]  # nobody sets it
        """Way of each joint, rad."""
        return np.asarray(np.array(self._move.target) - self.start)

    @cached_property
    def bending(self) -> Bending:
        """How strongly each body can leave a chord of the path."""
        return bending(self.robot, self.layout, self.delta)

    def q(self, s: float) -> Floats:
        """Joint angles at path parameter `s`."""
        return np.asarray(self.start + s * self.delta)

    def nodes(self, keys: Keys) -> tuple[NDArray[np.intp], Poses]:
        """Index of each key's configuration in the poses, and the poses; what is missing is computed."""
        new = [k for k in dict.fromkeys(keys.tolist()) if k not in self._known]
        if new:
            s = np.array(new) / GRID
            found = poses(self.robot, self.layout, self.start + s[:, None] * self.delta, self.delta)
            if self._poses is None:
                self._poses = found
            else:
                old = self._poses
                self._poses = Poses(
                    np.concatenate([old.ends, found.ends]),
                    np.concatenate([old.speed, found.speed]),
                    np.concatenate([old.spin, found.spin]),
                )
            first = len(self._known)
            self._known.update((k, first + i) for i, k in enumerate(new))
        known = self._known
        if self._poses is None:
            raise ValueError("no configuration was asked for")
        return np.array([known[k] for k in keys.tolist()], dtype=np.intp), self._poses

    def rush(self, low: Keys, high: Keys) -> Floats:
        """Bound on the surface speed per unit of ds/dt of every body on each interval, shape (intervals, bodies)."""
        count = len(low)
        at, known = self.nodes(np.concatenate([low, (low + high) // 2, high]))
        h2 = (((high - low) / GRID) ** 2)[:, None] / CHORD
        speed = known.speed[at].reshape(3, count, -1).max(axis=0) + self.bending.third * h2
        spin = known.spin[at].reshape(3, count, -1).max(axis=0) + self.bending.spin_second * h2
        return np.asarray(speed + self.layout.radius * spin)

    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """What is proven on each row's interval and attained in its middle."""
        intervals, row = np.unique(np.stack([low, high]), axis=1, return_inverse=True)
        cut_low, cut_high = intervals[0], intervals[1]
        count = len(cut_low)
        at, known = self.nodes(np.concatenate([cut_low, (cut_low + cut_high) // 2, cut_high]))
        at_mid = at[count : 2 * count]
        body = pairs.body[pair]
        cores = pairs.cores.take(pair)
        ends = known.ends[at.reshape(3, count)[:, row], body]
        distance, direction = core_distance(ends[1], cores)
        sag = self.bending.second[body] * ((high - low) / GRID) ** 2 / CHORD
        radii = pairs.radii[pair]
        clear = interval_clearance(ends, direction, cores, radii=radii, sag=sag)
        rush = self.rush(cut_low, cut_high)[row, body]
        rush_mid = known.speed[at_mid[row], body] + self.layout.radius[body] * known.spin[at_mid[row], body]
        return Leaves(low, high, pair, clear, rush, distance - radii, rush_mid)

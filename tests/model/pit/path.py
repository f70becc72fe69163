"""A straight path of the joints in numpy: the slow twin of `pep.pit.search.kernel.compiled_path.CompiledPath`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from pep.pit.geometry.clearance import core_distance
from pep.pit.path.path import Leaves
from pep.pit.path.straight_path import CHORD, GRID, Path
from pep.pit.robot.kinematics import Poses, layout, poses
from tests.model.pit.clearance import interval_clearance
from tests.model.pit.search import blow_ratio, certify, fits

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pep.pit.base.motion import Floats
    from pep.pit.path.path import Keys
    from pep.pit.robot.kinematics import Layout
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.pairs import Pairs


@dataclass(frozen=True, slots=True)
class Bending:
    """Bounds over the whole path, per body: second and third derivative of its ends, second of its spin."""

    second: Floats
    third: Floats
    spin_second: Floats


def bending(robot: Robot, plan: Layout, dq: Floats) -> Bending:
    """Greatest bending of each body away from a chord of the path."""
    share = np.abs(dq) * plan.moved_by
    outer = np.cumsum(share, axis=1)
    inner = outer - share
    second = (robot.reach * (outer**2 - inner**2)).sum(axis=1)
    third = (robot.reach * (outer**3 - inner**3)).sum(axis=1)  # third power: third derivative
    return Bending(second, third, (share * inner**2).sum(axis=1))


class Nodes:
    """Poses at one configuration, with the clearance of pairs and the searches on any path."""

    certify, fits, blow_ratio = certify, fits, blow_ratio

    def rush_at(self, pairs, key, pair):
        """Surface speed per unit of ds/dt of the body of each of these pairs at one configuration, metre."""
        at, known = self.nodes(np.array([key]))
        body = pairs.body[pair]
        return np.asarray(known.speed[at[0], body] + self.layout.radius[body] * known.spin[at[0], body])

    def clearance_at(self, pairs, key, pair):
        """Signed clearance of these pairs at one configuration, metre."""
        at, known = self.nodes(np.array([key]))
        distance, _ = core_distance(known.ends[at[0], pairs.body[pair]], pairs.cores.take(pair))
        return np.asarray(distance - pairs.radii[pair])


class NumpyPath(Nodes, Path):
    """A path whose questions numpy answers. Holds every configuration it was asked for."""

    def __init__(self, robot, move):
        super().__init__(robot, move)
        self.layout = layout(robot)
        self._known = {}
        self._poses = None

    @cached_property
    def bending(self) -> Bending:
        """Greatest bending of each body away from a chord of the path."""
        return bending(self.robot, self.layout, self.delta)

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
        """Leaves: the proven values on each row's interval, and the attained ones in its middle."""
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

"""What the searches ask of a path of the joints: the straight `Path` and the curved `Course` answer it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.clearance import core_distance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kinematics import Layout, Poses
    from pep.pit.motion import Floats
    from pep.pit.pairs import Pairs
    from pep.pit.path import Keys, Leaves
    from pep.pit.robot import Robot


class Route(ABC):
    """A way of one robot's joints whose parameter grows from 0 to 1. Places on it are whole multiples of 1 / GRID.

    Attributes:
        robot: whose joints they are.
        layout: its bodies.
        delta: how far each joint goes: the difference of a straight path's ends, a bound on a course, (6,), rad.
    """

    robot: Robot
    layout: Layout
    delta: Floats

    @abstractmethod
    def nodes(self, keys: Keys) -> tuple[NDArray[np.intp], Poses]:
        """Index of each key's configuration in the poses, and the poses; what is missing is computed."""

    @abstractmethod
    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """What is proven on each row's interval, and attained in its middle."""

    def halve(self, pairs: Pairs, leaves: Leaves, *, since: int = 0) -> Leaves:
        """Both halves of every row, examined; without those that end before `since`."""
        mid = leaves.mid
        low, high = np.concatenate([leaves.low, mid]), np.concatenate([mid, leaves.high])
        ahead = high > since
        return self.examine(pairs, low[ahead], high[ahead], np.concatenate([leaves.pair, leaves.pair])[ahead])

    def rush_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """Surface speed per unit of ds/dt of the body of each of these pairs at one configuration, metre."""
        at, known = self.nodes(np.array([key]))
        body = pairs.body[pair]
        return np.asarray(known.speed[at[0], body] + self.layout.radius[body] * known.spin[at[0], body])

    def clearance_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """Signed clearance of these pairs at one configuration, metre."""
        at, known = self.nodes(np.array([key]))
        distance, _ = core_distance(known.ends[at[0], pairs.body[pair]], pairs.cores.take(pair))
        return np.asarray(distance - pairs.radii[pair])

"""A straight joint path with its configurations computed once each, and rows of (interval, pair) examined on it.

Path parameters are whole multiples of 1 / GRID, so that halving an interval is exact and every configuration has one
name.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.path.path import Route

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats, Straight
    from pep.pit.robot.robot import Robot

GRID: Final = 2**24  # 6 bits for the first cut, 14 for halvings, 1 for midpoints, 3 to spare
CHORD: Final = 32  # 1 / (8 * 2^2): the chord lemma's h^2 / 8 with a third node in the middle


class Path(Route):
    """A joint move's path for one robot; not shared between threads."""

    def __init__(self, robot: Robot, move: Straight) -> None:
        """Makes a path of which nothing is computed yet."""
        self.robot, self._move = robot, move

    @cached_property
    def start(self) -> Floats:
        """Joint angles at the start, rad."""
        return np.array(self._move.start)

    @cached_property
    def delta(self) -> Floats:  # type: ignore[override]  # never set
        """Way of each joint, rad."""
        return np.asarray(np.array(self._move.target) - self.start)

    def q(self, s: float) -> Floats:
        """Joint angles at path parameter `s`."""
        return np.asarray(self.start + s * self.delta)

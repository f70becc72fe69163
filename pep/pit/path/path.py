"""Path of the joints as the searches use it, implemented by the straight `Path` and the curved `Course`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.pairs import Pairs

    Keys = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Leaves:
    """Rows of (interval, pair) with their findings.

    Attributes:
        low, high: the interval, in GRID units.
        pair: index into the pairs.
        clear_m: proven: clearance on the whole interval is at least this.
        rush: proven: surface speed per unit of ds/dt on the whole interval is at most this, metre.
        clear_mid_m, rush_mid: the same two, exactly, at the middle.
    """

    low: Keys
    high: Keys
    pair: NDArray[np.intp]
    clear_m: Floats
    rush: Floats
    clear_mid_m: Floats
    rush_mid: Floats

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.low)

    def take(self, which: NDArray[Any]) -> Leaves:
        """These rows."""
        return Leaves(*(getattr(self, f.name)[which] for f in fields(self)))

    @property
    def mid(self) -> Keys:
        """Middles of the intervals."""
        return (self.low + self.high) // 2

    @staticmethod
    def joined(parts: list[Leaves]) -> Leaves:
        """All rows of all parts."""
        return Leaves(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Leaves)))


NO_LEAVES: Final = Leaves(*(np.zeros(0, dtype=np.int64),) * 3, *(np.zeros(0),) * 4)


class Route(ABC):
    """Way of one robot's joints with a parameter from 0 to 1.

    Places on it are whole multiples of 1 / GRID.

    Attributes:
        robot: robot with these joints.
        delta: way of each joint: the difference of a straight path's ends, a bound on a course, (6,), rad.
    """

    robot: Robot
    delta: Floats

    @abstractmethod
    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """Bounds proven on each row's interval, and values attained in its middle."""

    def halve(self, pairs: Pairs, leaves: Leaves, *, since: int = 0) -> Leaves:
        """Both halves of every row, examined; without those that end before `since`."""
        mid = leaves.mid
        low, high = np.concatenate([leaves.low, mid]), np.concatenate([mid, leaves.high])
        ahead = high > since
        return self.examine(pairs, low[ahead], high[ahead], np.concatenate([leaves.pair, leaves.pair])[ahead])

    @abstractmethod
    def rush(self, low: Keys, high: Keys) -> Floats:
        """Bound on the surface speed per unit of ds/dt of every body on each interval, (intervals, bodies), metre."""

    @abstractmethod
    def rush_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """Surface speed per unit of ds/dt of the body of each of these pairs at one configuration, metre."""

    @abstractmethod
    def clearance_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """Signed clearance of these pairs at one configuration, metre."""

"""What the searches ask of a path of the joints: the straight `Path` and the curved `Course` answer it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pep.pit.motion import Floats
    from pep.pit.pairs import Pairs
    from pep.pit.path import Keys, Leaves
    from pep.pit.robot import Robot


class Route(Protocol):
    """A way of one robot's joints whose parameter grows from 0 to 1. Places on it are whole multiples of 1 / GRID."""

    @property
    def robot(self) -> Robot:
        """Whose joints they are."""

    @property
    def delta(self) -> Floats:
        """How far each joint goes: the difference of a straight path's ends, a bound on a course, (6,), rad."""

    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """What is proven on each row's interval, and attained in its middle."""

    def halve(self, pairs: Pairs, leaves: Leaves, *, since: int = 0) -> Leaves:
        """Both halves of every row, examined; without those that end before `since`."""

    def rush_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """Surface speed per unit of ds/dt of the body of each of these pairs at one configuration, metre."""

    def clearance_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """Signed clearance of these pairs at one configuration, metre."""

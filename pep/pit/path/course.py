"""A curved path of the joints, known by proven bounds on pieces, with the same questions as a straight `Path`.

A straight joint path bends everywhere alike; a line of the tool does not. So a course is tiled by cells, and on each
the first three derivatives of every joint are bounded; where the arm may also leave the course, by how much it may. An
interval takes the worst of the cells that it meets. With w, a, b the bounds of q', q'', q''' and S, A their sums up to
a joint, a point carried by the arm has |p''| <= sum_k reach_k (a_k + S_k^2 - S_(k-1)^2), and likewise |p'''|.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.pit.base.errors import UnprovenError
from pep.pit.path.path import Route
from pep.pit.path.straight_path import GRID

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.path.course_angles import Track
    from pep.pit.path.path import Keys
    from pep.pit.robot.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Pieces that tile [0, 1] in order, with bounds per joint that hold on the whole of each.

    Attributes:
        low, high: of each piece, in 1 / GRID, shape (n,).
        q, dq, ddq: configuration and derivatives in its middle, (n, 6), rad per power of s.
        first, second, third: bounds on the size of the derivatives, (n, 6).
        stray: distance of the arm beside the course there, at most, (n, 6), rad.
        hurry: by how much its joint speeds may differ from the course's, (n, 6), rad per unit of s.
    """

    low: Keys
    high: Keys
    q: Floats
    dq: Floats
    ddq: Floats
    first: Floats
    second: Floats
    third: Floats
    stray: Floats
    hurry: Floats

    def __len__(self) -> int:
        """Number of pieces."""
        return len(self.low)

    @property
    def mid(self) -> Keys:
        """Middles of the pieces."""
        return (self.low + self.high) // 2

    @property
    def way(self) -> Floats:
        """Greatest way of each joint, (6,), rad."""
        return np.asarray((self.first * ((self.high - self.low) / GRID)[:, None]).sum(axis=0))

    def holding(self, key: float) -> int:
        """The piece that holds this place."""
        return min(int(np.searchsorted(self.high, key, side="left")), len(self) - 1)

    @staticmethod
    def joined(parts: list[Cells]) -> Cells:
        """All pieces of all parts, in order."""
        parts = [_NO_CELLS, *parts]
        return Cells(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Cells)))


_NO_ROWS: Final[Any] = np.zeros((0, 6))  # of six joints
_NO_CELLS: Final = Cells(np.zeros(0, np.int64), np.zeros(0, np.int64), *([_NO_ROWS] * (len(fields(Cells)) - 2)))


class Course(Route):
    """Curved path for one robot; not shared between threads.

    It has no `start` and is no `Path`: a computation that needs straightness must not take it.
    """

    def __init__(self, robot: Robot, cells: Cells, track: Track) -> None:
        """Nothing is computed yet.

        Raises:
            UnprovenError: the cells do not tile all of it.
        """
        ends = np.concatenate([[0], cells.high])
        if not (len(cells) and np.array_equal(ends[:-1], cells.low) and ends[-1] == GRID):
            raise UnprovenError("the course is not whole")
        self.robot, self.cells, self.track = robot, cells, track
        self.delta = cells.way

    def at(self, s: float) -> tuple[Floats, Floats]:
        """Joint angles and their derivative by s at `s` in [0, 1]."""
        cells = self.cells
        cell = cells.holding(s * GRID)
        off = s - float(cells.mid[cell]) / GRID
        return self.track.at(self.robot, s, cells.q[cell] + off * (cells.dq[cell] + 0.5 * off * cells.ddq[cell]))

    def q(self, s: float) -> Floats:
        """Joint angles at `s`."""
        return self.at(s)[0]

    @property
    @abstractmethod
    def known(self) -> tuple[Keys, Floats]:
        """Every place asked for so far, (n,), and its configuration, (n, 6): the nodes of the proof."""


def straight_cells(
    start: Floats, delta: Floats, *, low: int, high: int = GRID, stray: Floats, hurry: Floats, count: int = 1
) -> Cells:
    """Cells of a straight joint path, with the allowed stray from it.

    Args:
        start: joint angles at `low`, (6,).
        delta: derivative by s, (6,).
        low: its beginning, in 1 / GRID.
        high: its end.
        stray: as in `Cells`, (6,).
        hurry: likewise.
        count: of equal pieces.
    """
    edges = np.linspace(low, high, count + 1).astype(np.int64)
    mid = (edges[:-1] + edges[1:]) // 2
    rows = np.ones((count, 1))
    still: Any = np.zeros((count, len(delta)))
    return Cells(
        low=edges[:-1],
        high=edges[1:],
        q=start + ((mid - low) / GRID)[:, None] * delta,
        dq=rows * delta,
        ddq=still,
        first=rows * np.abs(delta),
        second=still,
        third=still,
        stray=rows * stray,
        hurry=rows * hurry,
    )

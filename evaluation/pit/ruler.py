"""The least clearance on a whole path, asked of the search for the index: proven from below, attained from above.

The search answers with an index. Of things at rest, asked for at a creeping speed, the index is a ruler: over a band of
20 mm it rises by one, and the search resolves a hundredth of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.motion import profile_of
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.separation import stopping

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Straight
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.search.certify import Certified
    from pep.pit.search.engine import Engine
    from pep.pit.search.kernel.compiled_path import CompiledPath

COARSE_M: Final = 1.0
FINE_M: Final = 0.02
DEEPEST_M: Final = 0.3
"""No clearance is below minus this: the radii of two bodies together."""
REACH_M: Final = COARSE_M - DEEPEST_M
"""Greatest distance at which a clearance is asked for."""
BEYOND: Final = 1.0
"""Index of a thing beyond its band."""
AT_ZERO: Final = 2.0
"""Index of a thing where its band begins."""
CREEPING_RAD_S: Final = 1e-6
MIDDLE: Final = 0.55
"""Share of the fine band at which the attained clearance is laid.

A proven one that is a coarse step below is on the band too.
"""


@dataclass(frozen=True, slots=True)
class Least:
    """The least clearance of some pairs on a path, metre.

    Attributes:
        proven: no clearance is below it.
        attained: one that is met; infinite when all are beyond the ruler's reach.
    """

    proven: float
    attained: float


class Ruler:
    """Pairs made into things at rest, whose index is their clearance."""

    def __init__(
        self, engine: Engine, robot: Robot, cell: CellParameters, pairs: Pairs, rows: NDArray[np.intp]
    ) -> None:
        """Prepares a ruler for the pairs in `rows`; nothing is asked yet."""
        self._engine, self._robot, self._cell, self._rows = engine, robot, cell, rows
        count = len(pairs)
        self._pairs = replace(
            pairs,
            kind=np.full(count, pairs.code_of(PairKind.RIGID)),
            group=np.zeros(count, dtype=np.intp),
            violated_below=np.full(count, -math.inf),
        )

    def least(self, move: Straight) -> Least:
        """The least clearance on the way of a move that goes somewhere; its speed plays no part."""
        path = self._engine.path(self._robot, move)
        found = self._laid(path, move, zero=-DEEPEST_M, band=COARSE_M)
        if found.upper <= BEYOND:
            return Least(REACH_M, math.inf)
        # The least may lie one coarse step below the attained one, inside the fine band. An end at zero is laid again.
        while True:
            zero = found.witnesses[0].clearance_m - MIDDLE * FINE_M
            found = self._laid(path, move, zero=zero, band=FINE_M)
            if found.upper < AT_ZERO:
                return Least(zero + FINE_M * (AT_ZERO - found.upper), found.witnesses[0].clearance_m)

    def _laid(self, path: CompiledPath, move: Straight, *, zero: float, band: float) -> Certified:
        """Search over these pairs when the index is 2 at a clearance of `zero` and 1 at `band` beyond it."""
        count = len(self._pairs)
        pairs = replace(self._pairs, uncertainty=np.full(count, zero), band=np.full(count, band))
        profile = profile_of(move, CREEPING_RAD_S)
        if profile is None:
            raise ValueError("a move that goes nowhere")
        stop = stopping(self._cell, perception_age_s=0.0, joint_speed_rad_s=0.0)
        return path.certify(pairs, profile, stop, rows=self._rows, floor=1.0, check_time=_no_limit)


def _no_limit() -> None:
    """The time is not counted."""

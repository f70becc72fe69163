"""The joints' path under a straight line of the tool, traced piece by piece with bounds that prove themselves.

On a line of constant twist V the joints obey J q' = V, so J q'' = -J' q'. In the middle of a piece of half width r let
G be the inverse of J. Suppose |q''| <= a on the piece; then |q'| <= w = |q'(m)| + r a, the Jacobian is J(m) + (s - m)
J'(m) with an error of the second order, and J' q' differs from its value in the middle by a sum of levers times rates.
Together they bound |q''| again. Each a that exceeds this bound holds on the whole piece: at the first place of failure
it would already hold. At the ends the path lies within a r^2 / 2 of the middle's tangent, and where Newton's map is a
contraction on so small a box, what solves the pose there is the path and no other branch. A piece that proves nothing
is halved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from pep.pit.path.straight_path import GRID

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.path.course import Cells

Stuck = Literal["singular", "joint_limit"]

FIRST_PIECES: Final = 8  # equal ones; fewer only add a level
FINEST: Final = GRID // 2**11  # PHY-18: 11 halvings; what is not proven on so short a piece is not proven
PIECES_MOST: Final = 1024  # bounds time and memory; a line that keeps off singularities needs some dozens
ROUNDS: Final = 60  # of a fixed point: it closes in like a geometric series, or never
GROWTH: Final = 8.0  # a bound so many times the derivatives in the middle is of no use: halve
ROOM: Final = 0.2  # share of the derivatives in the middle by which a bound is tried above them
SLACK: Final = 0.15  # share of the fastest joint's rate by which a bound may exceed the rate in the middle
LOOSE: Final = 2.0  # likewise of the second derivative, as a multiple of the derivatives in the middle
ENOUGH: Final = GRID // 2**9  # pieces so short are kept however loose their bound is
BEND_OF_LOG: Final = 0.6  # the inverse left Jacobian of the logarithm differs from 1 by less than 0.6 angle up to 1 rad
ROUND_UP: Final = 1 + 1e-9  # far above float64 rounding of these sums
ROOM_ABOVE: Final = 1e-6  # a thousand times what the last round of a sum may still have added


@dataclass(frozen=True, slots=True, eq=False)
class LineTrace:
    """A line that was traced as far as was asked.

    Attributes:
        cells: the proven pieces, which tile all of it.
        q: joint angles at its end, (6,), rad.
        dq: their derivative by s there, (6,).
    """

    cells: Cells
    q: Floats
    dq: Floats


@dataclass(frozen=True, slots=True, eq=False)
class CutShort:
    """A line that could not be traced as far as was asked.

    Attributes:
        cells: the pieces that are proven, from the start on; there may be none.
        reached: their end, in 1 / GRID.
        q: joint angles there, (6,), rad.
        dq: their derivative by s, (6,); 0 where it has none, which is never at the end of a piece.
        stuck: why no further.
    """

    cells: Cells
    reached: int
    q: Floats
    dq: Floats
    stuck: Stuck

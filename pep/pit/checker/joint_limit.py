"""The joint limit that a line meets (PHY-48): shown here anew, on the piece of it that a document names.

Where the joints' path is in that piece is found by Newton's method and proven like any other, with a little less room.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.pit.checker.arm import GRID
from pep.pit.checker.piece import Lever, Piece, contraction
from pep.pit.checker.stance import stance
from pep.pit.checker.twist import apart

if TYPE_CHECKING:
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import CheckerStance, Six
    from pep.pit.checker.twist import CheckerTwist, Pose

FINEST: Final = GRID // 2**11  # PHY-18: the shortest piece, on which a joint limit is told
STEPS: Final = 12  # of Newton's method: it doubles the digits
EXACT: Final = 1e-11  # m and rad: it has arrived
FAR_RAD: Final = 0.5  # a step so long left the neighbourhood
ROUNDS: Final = 50  # of a bound that closes in on its own consequence
ROOM: Final = 0.2  # share of the derivatives by which a bound is tried above them
GROWTH: Final = 8.0  # a bound so many times the derivatives in the middle helps nobody


def meets_limit(robot: CheckerRobot, twist: CheckerTwist, here: CheckerStance, low: int, high: int) -> bool:
    """True where a joint may pass its limit from `low`, with the arm as `here`, to `high` (1 / GRID)."""
    lever, r = Lever(robot.tcp.levers), 0.5 * (high - low) / GRID
    rate = here.rates(twist.rate)
    near = tuple(q + r * d for q, d in zip(here.q, rate, strict=True))
    middle = _solved(robot, twist.at((low + high) / 2 / GRID), near)
    if middle is None:
        return False
    piece = Piece(lever, twist, middle, low, high)
    second = _bound(piece)
    if second is None:
        return False
    back, within = piece.near(low, second)
    on_it = all(abs(q - x) <= y for q, x, y in zip(here.q, back, within, strict=True))
    if not (on_it and contraction(lever, here, within) < 1):
        return False
    rows = zip(middle.q, piece.rates(second), robot.ranges, strict=True)
    return not all(lowest <= q - r * most <= q + r * most <= highest for q, most, (lowest, highest) in rows)


def _solved(robot: CheckerRobot, goal: Pose, near: Six) -> CheckerStance | None:
    """The arm with its tool at `goal`, by Newton's method from joint angles nearby."""
    q = near
    for _ in range(STEPS):
        here = stance(robot, q)
        if here is None:
            return None
        missing = apart(goal, here.pose)
        if max(map(abs, missing)) <= EXACT:
            return here
        step = here.rates(missing)
        if not max(map(abs, step)) <= FAR_RAD:
            return None
        q = tuple(x + y for x, y in zip(q, step, strict=True))
    return None


def _bound(piece: Piece) -> Six | None:
    """Bound of the second derivatives that proves itself, or None without one of any use."""
    fastest, hardest = (max(map(abs, rates)) for rates in (piece.dq, piece.ddq))
    a = tuple(abs(x) + ROOM * (fastest + hardest) for x in piece.ddq)
    for _ in range(ROUNDS):
        need = piece.follows(a)
        if all(x < y for x, y in zip(need, a, strict=True)):
            return need
        a = tuple(max(y, x * (1 + ROOM * ROOM)) for x, y in zip(need, a, strict=True))
        if not max(a) <= GROWTH * (fastest + hardest):
            return None
    return None

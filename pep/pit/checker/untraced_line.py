"""Reason why a line is not traced to its end (PHY-48), tried again with a little less room.

A doubt leaves the rest of a motion out of the proof, so it has to be a true one: a document may not break off a line
that can well be followed. A piece that the room's engine cannot follow fails here, too: the bounds here are a little
tighter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

from pep.pit.checker.arm import GRID
from pep.pit.checker.piece import Lever, Piece, contraction
from pep.pit.checker.stance import stance
from pep.pit.checker.twist import apart

if TYPE_CHECKING:
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import CheckerStance, Six
    from pep.pit.checker.twist import CheckerTwist, Pose

FINEST: Final = GRID // 2**10  # PHY-18: a line without proof on so short a piece has none
STEPS: Final = 12  # of Newton's method: it doubles the digits
EXACT: Final = 1e-11  # m and rad: it has arrived
FAR_RAD: Final = 0.5  # a step so long left the neighbourhood
ROUNDS: Final = 50  # of a bound that closes in on its own consequence
ROOM: Final = 0.2  # share of the derivatives by which a bound is tried above them
GROWTH: Final = 7.9  # a bound so many times the derivatives in the middle is of no use
SHRINKS: Final = 0.99  # Newton's map has to contract
INSIDE_RAD: Final = 1e-9  # from a joint's limit

Blocked = Literal["singular", "joint_limit"]


def blocked(robot: CheckerRobot, twist: CheckerTwist, here: CheckerStance, low: int, high: int) -> Blocked | None:
    """Reason why the line cannot be followed from `here` at `low` to `high`; None where it can.

    Places are in 1 / GRID.
    """
    lever, r = Lever(robot.tcp.levers), 0.5 * (high - low) / GRID
    rate = here.rates(twist.rate)
    middle = _solved(
        robot, twist.at((low + high) / 2 / GRID), tuple(q + r * d for q, d in zip(here.q, rate, strict=True))
    )
    if middle is None:
        return "singular"
    piece = Piece(lever, twist, middle, low, high)
    second = _bound(piece)
    if second is None:
        return "singular"
    ahead, within = piece.near(high, second)
    end = _solved(robot, twist.at(high / GRID), ahead)
    if end is None:
        return "singular"
    back, _ = piece.near(low, second)
    for node, near in ((here, back), (end, ahead)):
        inside = all(abs(q - x) <= SHRINKS * y for q, x, y in zip(node.q, near, within, strict=True))
        if not (inside and contraction(lever, node, within) < SHRINKS):
            return "singular"
    for q, most, (lowest, highest) in zip(middle.q, piece.rates(second), robot.ranges, strict=True):
        if not lowest + INSIDE_RAD <= q - r * most <= q + r * most <= highest - INSIDE_RAD:
            return "joint_limit"
    return None


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

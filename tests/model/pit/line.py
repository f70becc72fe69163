"""A line of the tool traced in numpy: the twin of the compiled pieces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pep.pit.path.course import Cells
from pep.pit.path.line_trace import (
    BEND_OF_LOG,
    ENOUGH,
    FINEST,
    FIRST_PIECES,
    GROWTH,
    LOOSE,
    PIECES_MOST,
    ROOM,
    ROOM_ABOVE,
    ROUND_UP,
    ROUNDS,
    SLACK,
    CutShort,
    LineTrace,
    Stuck,
)
from pep.pit.path.straight_path import GRID
from pep.pit.robot.inverse_kinematics import EXACT, Stance, solved, stance

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.twist import Twist


@dataclass(frozen=True, slots=True, eq=False)
class _Lever:
    """Bounds on how the Jacobian's columns change, from the reach of the tool point about each joint's axis.

    Each gives a pair: of the linear part, m, and of the angular, rad.
    """

    reach: Floats

    def first(self, w: Floats, v: Floats) -> Floats:
        """|sum_k J_k' v_k| at most, for joint rates of at most w."""
        s, t = np.cumsum(w), np.cumsum(v)
        return np.array([self.reach @ (s * t - (s - w) * (t - v)), v @ (s - w)])

    def second(self, w: Floats, a: Floats, v: Floats) -> Floats:
        """|sum_k J_k'' v_k| at most, for rates of at most w that change by at most a."""
        s, t = np.cumsum(w), np.cumsum(v)
        bent = np.array([self.reach @ (s**2 * t - (s - w) ** 2 * (t - v)), v @ (s - w) ** 2])
        return np.asarray(bent + self.first(a, v))


def trace(
    robot: Robot,
    twist: Twist,
    start: Floats,
    *,
    since: int = 0,
    until: int = GRID,
    pieces: int = FIRST_PIECES,
    fastest: Floats,
    check_time: Callable[[], None],
) -> LineTrace | CutShort:
    """Joints' path under a line between two places, or as much of it as can be proven.

    Args:
        robot: the arm.
        twist: the line of its tool.
        start: joint angles at `since`, (6,).
        since: where the part that is asked for begins.
        until: where it ends; `pieces` times a power of two divides it.
        pieces: of the first cut; more of them are each bounded more tightly.
        fastest: a rate of the joints, (6,), rad per unit of s, beyond which nothing more is to be proven.
        check_time: raises when the answer would come too late.
    """
    width = (until - since) // pieces
    todo = [(since + k * width, since + (k + 1) * width) for k in reversed(range(pieces))]
    here = stance(robot, start)
    done: list[Cells] = []
    while todo:
        check_time()
        low, high = todo.pop()
        # Far longer than the one before it has proven nothing yet: do not even try.
        wide = bool(done) and high - low > 2 * int(done[-1].high[0] - done[-1].low[0])
        found = "singular" if wide else _piece(robot, twist, here, low, high)
        if isinstance(found, tuple):
            cell, ahead = found
            if (np.abs(cell.dq[0]) > fastest).any():
                return _traced(twist, done, low, here, "singular")
            here = ahead
            done.append(cell)
        elif high - low <= FINEST:
            return _traced(twist, done, low, here, found)
        elif len(done) >= PIECES_MOST:
            return _traced(twist, done, low, here, "singular")
        else:
            mid = (low + high) // 2
            todo += [(mid, high), (low, mid)]
    return _traced(twist, done, until, here, None)


def _traced(twist: Twist, done: list[Cells], reached: int, end: Stance, stuck: Stuck | None) -> LineTrace | CutShort:
    dq = _solution(end.jacobian, twist.rate)
    dq = np.zeros_like(end.q) if dq is None else dq
    cells = Cells.joined(done)
    return LineTrace(cells, end.q, dq) if stuck is None else CutShort(cells, reached, end.q, dq, stuck)


def _piece(robot: Robot, twist: Twist, here: Stance, low: int, high: int) -> tuple[Cells, Stance] | Stuck:
    """The proven cell [low, high] and the arm at its end, when the arm stands as `here` at its start."""
    r = 0.5 * (high - low) / GRID
    lever = _Lever(robot.reach[robot.body_index("tcp")])
    rate = _solution(here.jacobian, twist.rate)
    middle = None if rate is None else solved(robot, twist.at((low + high) / 2 / GRID), here.q + r * rate)
    inverse = None if middle is None else _solution(middle.jacobian, np.eye(len(twist.rate)))
    if middle is None or inverse is None:
        return "singular"
    dq = inverse @ twist.rate
    bend = middle.bend(dq)
    ddq = -inverse @ (bend @ dq)
    proven = _derivatives(lever, _Middle(dq, ddq, _gain(inverse), np.abs(inverse @ bend)), r)
    if proven is None:
        return "singular"
    first, second, third = proven
    fastest, hardest = float(np.abs(dq).max()), float(np.abs(ddq).max())
    loose = r * second.max() > SLACK * fastest or second.max() > LOOSE * (hardest + fastest)
    if high - low > ENOUGH and loose:
        return "singular"
    end = solved(robot, twist.at(high / GRID), middle.q + r * (dq + 0.5 * r * ddq))
    # What Newton leaves, in joint angles; twice, since the inverse is the middle's.
    slip = 2 * EXACT * np.abs(inverse).sum(axis=1)
    within = 0.5 * r * r * second + slip
    if end is None or not (
        _on_path(lever, here, middle.q - r * dq, within) and _on_path(lever, end, middle.q + r * dq, within)
    ):
        return "singular"
    lowest, highest = robot.position_ranges_rad
    if not ((lowest <= middle.q - r * first) & (middle.q + r * first <= highest)).all():
        return "joint_limit"
    cell = Cells(
        low=np.array([low]),
        high=np.array([high]),
        q=middle.q[None],
        dq=dq[None],
        ddq=ddq[None],
        first=first[None],
        second=second[None],
        third=third[None],
        stray=slip[None],
        hurry=np.zeros((1, len(dq))),
    )
    return cell, end


def _solution(matrix: Floats, right: Floats) -> Floats | None:
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return None


def _gain(inverse: Floats) -> Floats:
    """Greatest effect of a linear and an angular deviation on each joint, (6, 2)."""
    half = len(inverse) // 2
    return np.stack([np.linalg.norm(inverse[:, :half], axis=1), np.linalg.norm(inverse[:, half:], axis=1)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Middle:
    """Middle of a piece: derivatives of the joints (6,), gain of the inverse (6, 2), |G J'| (6, 6)."""

    dq: Floats
    ddq: Floats
    gain: Floats
    mixed: Floats


def _derivatives(lever: _Lever, middle: _Middle, r: float) -> tuple[Floats, Floats, Floats] | None:
    """Bounds of the first three derivatives of the joints within `r` of the middle, or None when they prove nothing."""
    dq, ddq, gain, mixed = middle.dq, middle.ddq, middle.gain, middle.mixed
    fastest, hardest = float(np.abs(dq).max()), float(np.abs(ddq).max())

    def off(w: Floats, a: Floats, x: Floats) -> Floats:
        """|G (J - J(m))| x at most, for |q'| <= w and |q''| <= a."""
        return np.asarray(r * (mixed @ x) + 0.5 * r * r * (gain @ lever.second(w, a, x)))

    def follows(a: Floats) -> Floats:
        """The bound of |q''| that follows from the bound a."""
        w = np.abs(dq) + r * a
        change = lever.second(w, a, w) + lever.first(w, a)  # of J' q', per unit of s
        return np.asarray((np.abs(ddq) + r * (gain @ change) + off(w, a, a)) * ROUND_UP)

    a = np.abs(ddq) + ROOM * (hardest + fastest)
    for _ in range(ROUNDS):
        need = follows(a)
        if (need < a).all():
            break
        a = np.maximum(a, need * (1 + ROOM * ROOM))
        if not a.max() <= GROWTH * (hardest + fastest):
            return None
    else:
        return None
    for _ in range(3):  # what follows from a bound is a bound: bring it down
        a = np.minimum(a, follows(a))
    w = (np.abs(dq) + r * a) * ROUND_UP
    # J q''' = -J'' q' - 2 J' q'', and the same inverse; each round adds less than the one before.
    constant = gain @ (lever.second(w, a, w) + 2 * lever.first(w, a))
    b = constant
    for _ in range(ROUNDS):
        more = constant + off(w, a, b)
        if (more <= b * ROUND_UP).all():
            return w, a, np.asarray(b * (1 + ROOM_ABOVE))
        b = more
    return None


def _on_path(lever: _Lever, node: Stance, near: Floats, within: Floats) -> bool:
    """True where `node` is within `within` (6,) of `near` (6,), the only configuration there with its pose.

    Two of them differ by at most twice that, joint by joint; on so small a box Newton's map from `node` contracts.
    """
    if not (np.abs(node.q - near) <= within + EXACT).all():
        return False
    wide = 2 * (within + EXACT)
    angle = float(wide.sum())
    inverse = _solution(node.jacobian, np.eye(len(near)))
    if inverse is None or not angle <= 1:
        return False
    apart = lever.first(wide, np.ones(len(near))) + np.array([0, BEND_OF_LOG * angle * len(near)])
    return bool((_gain(inverse) @ apart).max() < 1)

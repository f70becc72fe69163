"""Path of the joints under a line of the tool, piece by piece (proof: `pep.pit.path.line_trace`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.path.line_trace import ENOUGH, FINEST, LOOSE, PIECES_MOST, SLACK
from pep.pit.path.straight_path import GRID
from pep.pit.robot.inverse_kinematics import EXACT
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.line_piece import gain_of, no_bounds, on_path, prove_derivatives
from pep.pit.search.kernel.arithmetic.tool_pose import JOINTS, bend_of, inverted, no_stand, solved, stand_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.line_piece import PieceBounds
    from pep.pit.search.kernel.arithmetic.tool_pose import KernelTwist, Stand, Wrist

    Whole = NDArray[np.int64]

PROVEN: Final = 0
SINGULAR: Final = 1
JOINT_LIMIT: Final = 2
FIRST: Final = 128  # room for pieces at first; most lines need some dozens


class TracedArm(NamedTuple):
    """Arm as a trace needs it.

    Attributes:
        wrist: its joints and tool point.
        reach: of the tool point about each joint's axis, (6,), m.
        lowest, highest: joint angles that it may take, (6,), rad.
    """

    wrist: Wrist
    reach: Floats
    lowest: Floats
    highest: Floats


class TracedLine(NamedTuple):
    """A line as far as traced: its pieces as in `pep.pit.path.course.Cells`, and the arm's stance at their end.

    Attributes:
        low, high: of each piece, (n,), in 1 / GRID.
        rows: (n, 7, 6): q, dq, ddq in its middle, bounds of the three derivatives, what strays.
        reached: end of the pieces.
        q, dq: joint angles there, and their derivative by s, (6,).
        stuck: `PROVEN`, `SINGULAR` or `JOINT_LIMIT`.
    """

    low: Whole
    high: Whole
    rows: Floats
    reached: int
    q: Floats
    dq: Floats
    stuck: int


Q: Final = 0
DQ: Final = 1
DDQ: Final = 2
ONE: Final = 3
TWO: Final = 4
THREE: Final = 5
STRAY: Final = 6
ROWS: Final = 7


class _Desk(NamedTuple):
    """Room for the work on a piece."""

    middle: Stand
    inverse: Floats
    bend: Floats
    bounds: PieceBounds
    room: Floats
    near: Floats
    within: Floats
    gain: Floats


@compiled
def _times(matrix: Floats, vector: Floats, out: Floats) -> None:
    for i in range(JOINTS):
        whole = 0.0
        for j in range(JOINTS):
            whole += matrix[i, j] * vector[j]
        out[i] = whole


@compiled
def _largest(vector: Floats) -> float:
    most = 0.0
    for i in range(JOINTS):
        if not abs(vector[i]) <= most:
            most = abs(vector[i])
    return most


@compiled
def _piece(
    tool: TracedArm, line: KernelTwist, rate: Floats, here: Stand, back: Floats, low: int, high: int, ahead: Stand,
    on: Floats, desk: _Desk, row: Floats,
) -> int:  # fmt: skip
    """Proves the piece [low, high]: writes its bounds to `row`, its end to `ahead`, that one's inverse to `on`.

    Args:
        tool: the arm.
        line: its tool's.
        rate: of the tool, linear and angular, (6,).
        here: the arm at `low`; back: the inverse of its Jacobian.
        low, high: in 1 / GRID.
        ahead, on, row: for the answer.
        desk: room.
    """
    r = 0.5 * (high - low) / GRID
    middle, bounds, near, within = desk.middle, desk.bounds, desk.near, desk.within
    dq, ddq, mixed, inverse, bend = bounds.dq, bounds.ddq, bounds.mixed, desk.inverse, desk.bend
    second, first, third, lowest, highest = bounds.second, bounds.first, bounds.third, tool.lowest, tool.highest
    begin, mid, end = here.q, middle.q, ahead.q
    _times(back, rate, dq)
    for i in range(JOINTS):
        mid[i] = begin[i] + r * dq[i]
    if not solved(tool.wrist, line, (low + high) / 2 / GRID, middle, desk.room):
        return SINGULAR
    if not inverted(middle.jacobian, inverse, desk.room):
        return SINGULAR
    _times(inverse, rate, dq)
    bend_of(middle, dq, bend)
    _times(bend, dq, near)
    for i in range(JOINTS):
        whole = 0.0
        for j in range(JOINTS):
            whole += inverse[i, j] * near[j]
            both = 0.0
            for k in range(JOINTS):
                both += inverse[i, k] * bend[k, j]
            mixed[i, j] = abs(both)
        ddq[i] = -whole
    gain_of(inverse, bounds.gain)
    fastest, hardest = _largest(dq), _largest(ddq)
    if not prove_derivatives(tool.reach, bounds, r, fastest, hardest):
        return SINGULAR
    most = _largest(second)
    if high - low > ENOUGH and (r * most > SLACK * fastest or most > LOOSE * (hardest + fastest)):
        return SINGULAR
    for i in range(JOINTS):
        end[i] = mid[i] + r * (dq[i] + 0.5 * r * ddq[i])
    if not solved(tool.wrist, line, high / GRID, ahead, desk.room) or not inverted(ahead.jacobian, on, desk.room):
        return SINGULAR
    for i in range(JOINTS):
        slip = 0.0
        for j in range(JOINTS):
            slip += abs(inverse[i, j])
        row[STRAY, i] = (
            2 * EXACT * slip
        )  # error of Newton's method, in joint angles; twice, since the inverse is the middle's
        within[i] = 0.5 * r * r * second[i] + row[STRAY, i]
        near[i] = mid[i] - r * dq[i]
    if not on_path(tool.reach, here.q, back, near, within, desk.gain, desk.room):
        return SINGULAR
    for i in range(JOINTS):
        near[i] = mid[i] + r * dq[i]
    if not on_path(tool.reach, ahead.q, on, near, within, desk.gain, desk.room):
        return SINGULAR
    for i in range(JOINTS):
        way = r * first[i]
        if not (mid[i] - way >= lowest[i] and mid[i] + way <= highest[i]):
            return JOINT_LIMIT
        row[Q, i], row[DQ, i], row[DDQ, i] = mid[i], dq[i], ddq[i]
        row[ONE, i], row[TWO, i], row[THREE, i] = first[i], second[i], third[i]
    return PROVEN


@compiled
def _rate_of(line: KernelTwist) -> Floats:
    rate = np.empty(JOINTS)
    for i in range(3):
        rate[i], rate[3 + i] = line.line[i], line.turn[i]
    return rate


@entry
def traced(
    tool: TracedArm, line: KernelTwist, start: Floats, since: int, until: int, pieces: int, fastest: Floats
) -> TracedLine:
    """Path of the joints under the line from `since` to `until`, as far as it can be proven."""
    rate = _rate_of(line)
    desk = _Desk(
        no_stand(), np.empty((6, 6)), np.empty((6, 6)), no_bounds(), np.empty((8, 6)), np.empty(6), np.empty(6),
        np.empty((6, 2)),
    )  # fmt: skip
    here, ahead = no_stand(), no_stand()
    back, on = np.empty((JOINTS, JOINTS)), np.empty((JOINTS, JOINTS))
    copy_into(here.q, start)
    stand_at(tool.wrist, here)
    known = inverted(here.jacobian, back, desk.room)
    low, high = np.empty(FIRST, np.int64), np.empty(FIRST, np.int64)
    rows = np.empty((FIRST, ROWS, JOINTS))
    open_low, open_high = np.empty(pieces + 32, np.int64), np.empty(pieces + 32, np.int64)  # 32: more than GRID halves
    width = (until - since) // pieces
    waiting, done, reached, stuck = pieces, 0, until, PROVEN
    for k in range(pieces):
        begin = since + (pieces - 1 - k) * width
        open_low[k], open_high[k] = begin, begin + width
    while waiting > 0:
        waiting -= 1
        begin, end = open_low[waiting], open_high[waiting]
        if done == low.shape[0]:
            low, high, rows = _doubled(low, high, rows)
        # Far longer than the one before it has proven nothing yet: do not even try.
        found = SINGULAR
        if known and not (done > 0 and end - begin > 2 * (high[done - 1] - low[done - 1])):
            found = _piece(tool, line, rate, here, back, begin, end, ahead, on, desk, rows[done])
        if found == PROVEN:
            for i in range(JOINTS):
                if not abs(rows[done, DQ, i]) <= fastest[i]:
                    found = SINGULAR
            if found == SINGULAR:
                reached, stuck = begin, SINGULAR
                break
            low[done], high[done] = begin, end
            done += 1
            here, ahead = ahead, here
            back, on = on, back
        elif end - begin <= FINEST:
            reached, stuck = begin, found
            break
        elif done >= PIECES_MOST:
            reached, stuck = begin, SINGULAR
            break
        else:
            mid = (begin + end) // 2
            open_low[waiting], open_high[waiting] = mid, end
            open_low[waiting + 1], open_high[waiting + 1] = begin, mid
            waiting += 2
    dq = np.zeros(JOINTS)
    if known:
        _times(back, rate, dq)
    return TracedLine(low[:done].copy(), high[:done].copy(), rows[:done].copy(), reached, here.q.copy(), dq, stuck)


@compiled
def _doubled(low: Whole, high: Whole, rows: Floats) -> tuple[Whole, Whole, Floats]:
    """The same with twice the room."""
    count = low.shape[0]
    more, ends = np.empty(2 * count, np.int64), np.empty(2 * count, np.int64)
    wide = np.empty((2 * count, ROWS, JOINTS))
    copy_into(more, low)
    copy_into(ends, high)
    copy_into(wide, rows)
    return more, ends, wide

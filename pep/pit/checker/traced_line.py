"""A line of the tool that the joints follow, to its end or to a joint's limit (PHY-18, PHY-47, PHY-48)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.arm import GRID, frames
from pep.pit.checker.course import CheckerCourse
from pep.pit.checker.curved_motion import PAST_LIMIT, STILL, CheckerTimedCourse, FixedAnswer, beyond, fixed, standing
from pep.pit.checker.distances import plus, turned
from pep.pit.checker.joint_limit import FINEST, meets_limit
from pep.pit.checker.laws import SAME
from pep.pit.checker.motion import STILL_RAD, Timing
from pep.pit.checker.robot import JOINTS
from pep.pit.checker.text import truth, whole
from pep.pit.checker.trace_pieces import PLACE, CheckerTracedLine, record_of
from pep.pit.checker.twist import apart, between, turned_by
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.motion import CheckerLine, Joints
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import Six
    from pep.pit.checker.twist import CheckerTwist, Pose

HALF_TURN_RAD: Final = math.pi - 0.01  # PHY-18
STATED_M: Final = 0.002  # PHY-18
STATED_RAD: Final = 0.002  # likewise


def followed_line(
    robot: CheckerRobot, start: Six, motion: CheckerLine, row: dict[str, Any]
) -> CheckerTimedCourse | FixedAnswer:
    """Line from rest to rest, as it is recorded.

    Raises:
        Refusal: the record is not this line's course.
    """
    if beyond(robot, start):
        return fixed(row, PAST_LIMIT)
    begin = tool_at(robot, start)
    twist = between(begin, _pose(motion.target))
    if motion.stated is not None:
        off = apart(_pose(motion.stated), begin)
        near = size(off[:3]) <= STATED_M * (1 + SAME) and size(off[3:]) <= STATED_RAD * (1 + SAME)
        need(near, Code.ANSWER_WRONG, "question.motion.stated_start")
    if not twist.way_m > STILL_RAD:
        return fixed(row, STILL)
    need(size(twist.turn) <= HALF_TURN_RAD, Code.UNPROVEN, "question.motion.target")
    need(row["seconds"] is None, Code.MEMBER_WRONG, PLACE)
    timing = Timing(twist.way_m, motion.speed, motion.acceleration, motion.acceleration)
    push = motion.acceleration / twist.way_m
    tool = motion.speed * size(twist.line) / twist.way_m
    if truth(row["limit"], f"{PLACE}.limit"):
        return ends_at_limit(robot, twist, start, row)
    traced = traced_until(robot, twist, start, row, GRID)
    return CheckerTimedCourse(
        CheckerCourse(robot, traced.pieces, traced.rated(), None), timing, (push, push), tool, traced.nodes[GRID].q
    )


def size(vector: Sequence[float]) -> float:
    """Euclidean norm."""
    return math.hypot(*vector)


def tool_at(robot: CheckerRobot, q: Six) -> Pose:
    """Pose of the tool."""
    turns, origins = frames(robot, q)
    return plus(turned(turns[JOINTS], robot.tcp.a), origins[JOINTS]), turns[JOINTS]


def _pose(six: Joints) -> Pose:
    x, y, z, u, v, w = six
    return (x, y, z), turned_by((u, v, w))


def traced_until(
    robot: CheckerRobot, twist: CheckerTwist, start: Six, row: dict[str, Any], until: int
) -> CheckerTracedLine:
    """Recorded line, followed to this place inside all joint limits.

    Raises:
        Refusal: it is not.
    """
    need(type(row["until"]) is int and row["until"] == until, Code.CELL_UNPROVEN, f"{PLACE}.until")
    need(row["ahead"] is None, Code.MEMBER_WRONG, PLACE)
    record = record_of(row)
    need(len(record.edges) > 1 and record.edges[-1] == until, Code.CELL_UNPROVEN, f"{PLACE}.edges")
    return _inside(robot, CheckerTracedLine(robot, twist, start, record))


def _inside(robot: CheckerRobot, traced: CheckerTracedLine) -> CheckerTracedLine:
    for number, piece in enumerate(traced.pieces):
        half = 0.5 * (piece.high - piece.low) / GRID
        middle = traced.nodes[(piece.low + piece.high) // 2].q
        met = beyond(robot, middle, [half * most for most in piece.first])
        need(not met, Code.ANSWER_WRONG, f"piece {number}: a joint limit")
    return traced


def ends_at_limit(robot: CheckerRobot, twist: CheckerTwist, start: Six, row: dict[str, Any]) -> FixedAnswer:
    """A line that is followed to a joint's limit, which is met on the piece behind it.

    Raises:
        Refusal: what is recorded is not this line's course, or no limit is met there.
    """
    place = f"{PLACE}.ahead"
    until = whole(row["until"], f"{PLACE}.until", low=0, high=GRID - 1)
    ahead = whole(row["ahead"], place, low=until + 1, high=min(until + FINEST, GRID))
    record = record_of(row)
    if record.edges:
        need(record.edges[-1] == until, Code.CELL_UNPROVEN, f"{PLACE}.edges")
        here = _inside(robot, CheckerTracedLine(robot, twist, start, record)).nodes[until]
    else:
        need(until == 0 and not record.nodes, Code.CELL_UNPROVEN, f"{PLACE}.until")
        here = standing(robot, start)
    need(meets_limit(robot, twist, here, until, ahead), Code.LIMIT_UNFOUNDED, place)
    return PAST_LIMIT

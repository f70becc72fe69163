"""Line of the tool that the joints follow to its end, or as far as they can (PHY-18, PHY-47, PHY-48)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.arm import GRID, frames
from pep.pit.checker.course import UNBOUNDED, CheckerCourse, Tail
from pep.pit.checker.curved_motion import NONE, CheckerTimedCourse, FixedAnswer, beyond, fixed, standing
from pep.pit.checker.distances import plus, turned
from pep.pit.checker.laws import HIGHEST, SAME
from pep.pit.checker.motion import STILL_RAD, Timing
from pep.pit.checker.robot import JOINTS
from pep.pit.checker.text import exact, listed, table, truth, whole, word
from pep.pit.checker.trace_pieces import PLACE, CheckerPieceBounds, CheckerTracedLine, record_of
from pep.pit.checker.twist import apart, between, turned_by
from pep.pit.checker.untraced_line import FINEST, blocked
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.motion import CheckerLine, Joints
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import Six
    from pep.pit.checker.twist import CheckerTwist, Pose

DOUBTFUL: Final = 3.0  # PHY-18: index of a motion that is not proven to its end
HALF_TURN_RAD: Final = math.pi - 0.01  # PHY-18
STATED_M: Final = 0.002  # PHY-18
STATED_RAD: Final = 0.002  # likewise
TOO_FAST: Final = 4.0  # PHY-18: times a joint's limit
LONGEST: Final = GRID // 8  # PHY-48: no piece is longer, so a fast place hides no more than that
ASKED_POSES: Final = 33  # PHY-18: poses of the rest for which joint angles are shown
REACHED: Final = 1e-4  # m and rad: so near, Newton's method would end there


def followed_line(
    robot: CheckerRobot, start: Six, motion: CheckerLine, row: dict[str, Any]
) -> CheckerTimedCourse | FixedAnswer:
    """Line from rest to rest, as it is recorded.

    Raises:
        Refusal: the record is not this line's course.
    """
    if beyond(robot, start):
        return fixed(row, HIGHEST, ("joint_limit",), "joint_limit")
    begin = tool_at(robot, start)
    twist = between(begin, _pose(motion.target))
    if motion.stated is not None:
        off = apart(_pose(motion.stated), begin)
        near = size(off[:3]) <= STATED_M * (1 + SAME) and size(off[3:]) <= STATED_RAD * (1 + SAME)
        need(near, Code.ANSWER_WRONG, "question.motion.stated_start")
    if not twist.way_m > STILL_RAD:
        return fixed(row, 0.0, (), None)
    if not size(twist.turn) <= HALF_TURN_RAD:
        return fixed(row, DOUBTFUL, (), "half_turn")
    need(row["seconds"] is None, Code.MEMBER_WRONG, PLACE)
    timing = Timing(twist.way_m, motion.speed, motion.acceleration, motion.acceleration)
    push = motion.acceleration / twist.way_m
    tool = motion.speed * size(twist.line) / twist.way_m
    if row["doubt"] is not None:
        return broken_off(robot, twist, start, row, timing=timing, push=push, tool_speed=tool)
    traced = traced_until(robot, twist, start, row, GRID)
    return CheckerTimedCourse(
        CheckerCourse(robot, traced.pieces, traced.rated(), None), timing, push, tool, None, traced.nodes[GRID].q
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
    need(row["ahead"] is None and row["angles"] == [], Code.MEMBER_WRONG, PLACE)
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


def broken_off(
    robot: CheckerRobot,
    twist: CheckerTwist,
    start: Six,
    row: dict[str, Any],
    *,
    timing: Timing,
    push: float,
    tool_speed: float,
) -> CheckerTimedCourse | FixedAnswer:
    """Line that breaks off and comes to rest; its end is tried again.

    Raises:
        Refusal: the record is not this line's course, or the line can well be followed further.
    """
    doubt = word(row["doubt"], f"{PLACE}.doubt", among=("singular", "unreachable", "joint_limit"))
    until = whole(row["until"], f"{PLACE}.until", low=0, high=GRID - 1)
    ahead = table(row["ahead"], f"{PLACE}.ahead", ("until", "fast"))
    reach = whole(ahead["until"], f"{PLACE}.ahead", low=until + 1, high=GRID)
    fast = truth(ahead["fast"], f"{PLACE}.ahead")
    record = record_of(row)
    # 1. The line as far as it goes, and the piece behind it where that is proven, but too fast.
    ends = (until, reach) if fast else (until,) if record.edges else ()
    need(record.edges[len(record.edges) - len(ends) :] == ends, Code.CELL_UNPROVEN, f"{PLACE}.edges")
    traced = _inside(robot, CheckerTracedLine(robot, twist, start, record)) if record.edges else None
    need(traced is not None or (until == 0 and not record.nodes), Code.CELL_UNPROVEN, f"{PLACE}.until")
    pieces = [] if traced is None else [piece for piece in traced.pieces if piece.high <= until]
    here = standing(robot, start) if traced is None else traced.nodes[until]
    # 2. The doubt is a true one.
    if fast:
        assert traced is not None
        rows = zip(traced.pieces[-1].dq, robot.speed_limits, strict=True)
        too_fast = any(abs(rate) * timing.plateau > TOO_FAST * limit * (1 - SAME) for rate, limit in rows)
        need(too_fast and doubt != "joint_limit", Code.DOUBT_UNFOUNDED, f"{PLACE}.doubt")
        need(reach - until <= LONGEST, Code.DOUBT_UNFOUNDED, f"{PLACE}.ahead")
    else:
        need(reach - until <= FINEST, Code.DOUBT_UNFOUNDED, f"{PLACE}.ahead")
        why = blocked(robot, twist, here, until, reach)
        need(why == "singular" or (why is not None and why == doubt), Code.DOUBT_UNFOUNDED, f"{PLACE}.doubt")
    if doubt == "singular":
        _reachable(robot, twist, until, row["angles"])
    else:
        need(row["angles"] == [], Code.MEMBER_WRONG, f"{PLACE}.angles")
    # 3. What is left to answer.
    if doubt == "joint_limit":
        return FixedAnswer(HIGHEST, ("joint_limit",), doubt)
    if traced is None or not pieces:
        return FixedAnswer(DOUBTFUL, ("unreachable",) if doubt == "unreachable" else (), doubt)
    width = min(FINEST, GRID - until)
    tail = Tail(until, here.q, here.rates(twist.rate), width / GRID)
    nodes = {key: each for key, each in traced.rated().items() if key <= until}
    return CheckerTimedCourse(
        CheckerCourse(robot, [*pieces, *_fading(tail, width)], nodes, tail), timing, push, tool_speed, doubt, here.q
    )


def _fading(tail: Tail, width: int) -> list[CheckerPieceBounds]:
    """Bounds of a course that comes to rest within `width`, and stays there."""
    high, fade = tail.since + width, width / GRID
    sizes = tuple(map(abs, tail.dq))
    unbounded = (UNBOUNDED,) * JOINTS
    found = [
        CheckerPieceBounds(
            tail.since, high, tail.dq, NONE, sizes, tuple(x / fade for x in sizes), unbounded, NONE, NONE
        ),
        CheckerPieceBounds(high, GRID, NONE, NONE, NONE, NONE, unbounded, NONE, NONE),
    ]
    return found if high < GRID else found[:1]


def _reachable(robot: CheckerRobot, twist: CheckerTwist, until: int, value: Any) -> None:
    """Checks joint angles for each of the later poses: one out of reach would be a violation."""
    place = f"{PLACE}.angles"
    since = until / GRID
    for number, each in enumerate(listed(value, place, least=ASKED_POSES, most=ASKED_POSES)):
        q = tuple(exact(x, place) for x in listed(each, place, least=JOINTS, most=JOINTS))
        goal = twist.at(since + (1 - since) * number / (ASKED_POSES - 1))
        off = max(map(abs, apart(goal, tool_at(robot, q))))
        need(off <= REACHED * (1 + SAME), Code.DOUBT_UNFOUNDED, f"{place}: {number}")

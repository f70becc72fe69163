"""Held tool speed and servo target, each through the stop that ends it (PHY-19, PHY-20)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.arm import GRID
from pep.pit.checker.course import UNBOUNDED, CheckerCourse, Tail
from pep.pit.checker.curved_motion import (
    NONE,
    NOT_TRACED,
    PAST_LIMIT,
    STILL,
    CheckerTimedCourse,
    FixedAnswer,
    beyond,
    fixed,
)
from pep.pit.checker.laws import SAME
from pep.pit.checker.motion import Timing
from pep.pit.checker.robot import JOINTS
from pep.pit.checker.stance import LINEAR
from pep.pit.checker.text import exact, truth, whole
from pep.pit.checker.trace_pieces import PLACE, CheckerPieceBounds
from pep.pit.checker.traced_line import ends_at_limit, size, tool_at, traced_until
from pep.pit.checker.twist import CheckerTwist
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from pep.pit.checker.motion import CheckerHeldSpeed, CheckerServo
    from pep.pit.checker.question import Cell, CheckerView
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import Six
    from pep.pit.checker.trace_pieces import CheckerTracedLine

AT_ONCE: Final = 1e12  # acceleration of a motion under way: it has its speed from the first instant
LOOKAHEAD_LEAST_S: Final = 0.03  # PHY-20
STILL_RAD_S: Final = 1e-6  # PHY-20: one unit of the wire
ENVELOPE: Final = 8  # equal pieces on which the speeds of a servo target are bounded
LONGER: Final = 2.0  # PHY-48: times its hold; the course of a held speed that breaks off is no longer


def held_speed(
    robot: CheckerRobot, cell: Cell, start: Six, motion: CheckerHeldSpeed, row: dict[str, Any]
) -> CheckerTimedCourse | FixedAnswer:
    """Course of a tool velocity from rest, held, and the joints' stop along their tangent.

    s counts seconds at full speed.

    Raises:
        Refusal: the record is not this motion's course.
    """
    largest = max(map(abs, motion.velocity))
    if not largest > 0:
        return fixed(row, STILL)
    if beyond(robot, start):
        return fixed(row, PAST_LIMIT)
    # Nobody says how speed and turning grow together.
    uneven = any(motion.velocity[:LINEAR]) and any(motion.velocity[LINEAR:])
    need(not uneven, Code.UNPROVEN, "question.motion.twist")
    up = motion.acceleration / largest  # of the share of the full speed, 1/s
    held_s = motion.duration_s + cell.stop_delay_s
    peak = min(1.0, up * held_s)
    seconds = exact(row["seconds"], f"{PLACE}.seconds", low=_way(up, held_s) * (1 - SAME))
    x, y, z, u, v, w = (seconds * part for part in motion.velocity)
    twist = CheckerTwist(tool_at(robot, start), (x, y, z), (u, v, w))
    # 1. One that meets a joint's limit before its stop does so on a line.
    limit = truth(row["limit"], f"{PLACE}.limit")
    if limit and row["ahead"] is not None:
        # The finest piece is a part of the course: of a far longer one it would be longer than what it is taken for.
        need(seconds <= LONGER * _way(up, held_s), Code.CELL_UNPROVEN, f"{PLACE}.seconds")
        return ends_at_limit(robot, twist, start, row)
    end = whole(row["until"], f"{PLACE}.until", low=1, high=GRID - 1)
    s_end = end / GRID
    need(s_end * seconds >= _way(up, held_s) * (1 - SAME), Code.CELL_UNPROVEN, f"{PLACE}.until")
    traced = traced_until(robot, twist, start, row, end)
    # 2. The stop may take hold from the sending on; its difference from the course is stray and hurry.
    window = s_end - _way(up, motion.duration_s) / seconds
    pieces, bend = _strayed(traced, s_end, window)
    last = traced.nodes[end]
    rate = last.rates(twist.rate)
    # 3. It ends before the course does, wherever it takes hold: that is linear in where, so both ends tell.
    quick = (peak / seconds) ** 2 / (2 * cell.stop_deceleration_rad_s2)
    for earlier in (0.0, max(window, 0.0)):
        fastest = max(abs(r) + b * earlier for r, b in zip(rate, bend, strict=True))
        need(s_end - earlier + quick * fastest <= 1 + SAME, Code.CELL_UNPROVEN, f"{PLACE}.seconds")
    tail = Tail(end, last.q, rate)
    stopped, _ = tail.at(GRID)
    if beyond(robot, stopped, pieces[-1].stray):
        need(limit, Code.ANSWER_WRONG, f"{PLACE}.limit")
        return PAST_LIMIT
    need(not limit, Code.LIMIT_UNFOUNDED, f"{PLACE}.limit")
    straight = tuple(map(abs, rate))
    hurry = tuple(most * window for most in bend)
    pieces.append(
        CheckerPieceBounds(end, GRID, rate, NONE, straight, NONE, (UNBOUNDED,) * JOINTS, pieces[-1].stray, hurry)
    )
    braking = peak * peak / (2 * (1 - s_end) * seconds)
    return CheckerTimedCourse(
        CheckerCourse(robot, pieces, traced.rated(), tail),
        Timing(seconds, 1.0, up, braking),
        (up / seconds, braking / seconds),
        size(motion.velocity[:LINEAR]),
        stopped,
    )


def _way(up: float, until_s: float) -> float:
    """Way of a speed that grows at `up` to 1, in seconds at full speed."""
    ramp = min(1 / up, until_s)
    return up * ramp * (until_s - 0.5 * ramp)


def _strayed(traced: CheckerTracedLine, s_end: float, window: float) -> tuple[list[CheckerPieceBounds], Six]:
    """Pieces with the stray that an earlier stop adds, and the joints' greatest bend where it may begin."""
    late = (s_end - window) * GRID
    bend = tuple(max(rows) for rows in zip(*(p.second for p in traced.pieces if p.high > late), strict=True))
    beside = [most * (0.5 * window * window + window * (1 - s_end)) for most in bend]
    found = [
        piece
        if piece.high <= late
        else replace(
            piece,
            stray=tuple(x + y for x, y in zip(piece.stray, beside, strict=True)),
            hurry=tuple(x + most * window for x, most in zip(piece.hurry, bend, strict=True)),
        )
        for piece in traced.pieces
    ]
    return found, bend


def servo_target(
    robot: CheckerRobot, cell: Cell, start: Six, motion: CheckerServo, row: dict[str, Any], *, view: CheckerView
) -> CheckerTimedCourse | FixedAnswer:
    """Course of a servo target until a stop after it has ended; the question alone determines it.

    Raises:
        Refusal: something is recorded, or no joint may go so fast as this jump asks.
    """
    jump = [goal - q for goal, q in zip(motion.target, start, strict=True)]
    lookahead = max(motion.lookahead_s, LOOKAHEAD_LEAST_S)
    for way, limit in zip(jump, robot.speed_limits, strict=True):
        need(
            abs(way) <= limit * (motion.period_s + lookahead) * (1 + SAME), Code.ANSWER_WRONG, "question.motion.target"
        )
    asked = [way / lookahead for way in jump]
    fastest = max(map(abs, (*motion.rates, *asked)))
    if not fastest > STILL_RAD_S:
        return fixed(row, STILL)
    reaction = max(view.stopping_age_s, cell.watch_age_limit_s) + cell.reaction_s
    braking = cell.stop_deceleration_rad_s2 / fastest
    seconds = reaction + motion.period_s + cell.stop_delay_s + 1 / (2 * braking)
    both = list(zip(motion.rates, asked, strict=True))
    middle = tuple(seconds * 0.5 * (now + then) for now, then in both)
    spread = tuple(seconds * 0.5 * abs(now - then) for now, then in both)
    tail = Tail(0, start, middle)
    if beyond(robot, start, spread) or beyond(robot, tail.at(GRID)[0], spread):
        return fixed(row, PAST_LIMIT)
    types = type(row["until"]) is int and type(row["limit"]) is bool
    need(types and row == NOT_TRACED, Code.MEMBER_WRONG, PLACE)
    straight, step = tuple(map(abs, middle)), GRID // ENVELOPE
    pieces = [
        CheckerPieceBounds(low, low + step, middle, NONE, straight, NONE, NONE, spread, spread)
        for low in range(0, GRID, step)
    ]
    timing = Timing(seconds, 1.0, AT_ONCE, braking)
    return CheckerTimedCourse(
        CheckerCourse(robot, pieces, {}, tail), timing, (braking / seconds, braking / seconds), 0.0, start
    )

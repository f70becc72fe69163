"""Pieces of a timed trajectory, each straight in the joints, with the servo's tube and the stop (PHY-64, PHY-65)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.arm import GRID
from pep.pit.checker.course import CheckerCourse, Tail
from pep.pit.checker.curved_motion import (
    NONE,
    NOT_TRACED,
    PAST_LIMIT,
    CheckerTimedCourse,
    FixedAnswer,
    beyond,
    fixed,
)
from pep.pit.checker.held_motion import AT_ONCE, ENVELOPE
from pep.pit.checker.laws import SAME
from pep.pit.checker.motion import LEGS_MOST, CheckerTimedPiece, CheckerTrajectory, Timing
from pep.pit.checker.robot import JOINTS
from pep.pit.checker.text import exact, listed
from pep.pit.checker.trace_pieces import PLACE, CheckerPieceBounds
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.question import Cell
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import Six

LAG_S: Final = 0.06  # PHY-65: how far back the servo's targets count
HOLD_RAD: Final = 2e-3  # PHY-65: likewise
HOLD_RAD_S: Final = 1e-3  # PHY-65: likewise
RIPPLE: Final = 1.1  # PHY-65: factor of all joints' speeds


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Part of the curve with one acceleration: its times, and angles, rates and accelerations at its beginning."""

    since: float
    until: float
    q: Six
    v: Six
    a: Six

    def at(self, time: float) -> tuple[Six, Six]:
        """Angles and rates at a time."""
        on = time - self.since
        rows = list(zip(self.q, self.v, self.a, strict=True))
        return tuple(q + on * (v + on * a / 2) for q, v, a in rows), tuple(v + on * a for _, v, a in rows)


def pieces(robot: CheckerRobot, motion: CheckerTrajectory, ends: Any) -> tuple[CheckerTimedPiece, ...]:
    """The pieces that end at these times, which rise from 0 to the trajectory's end at most.

    Raises:
        Refusal: the times do not; a point that no joint reaches, or not in time.
    """
    place, last = "proof.until_s", motion.times[-1]
    times = [exact(each, place, low=0, high=last) for each in listed(ends, place, least=1, most=LEGS_MOST)]
    need(all(a < b for a, b in pairwise([0.0, *times])), Code.MEMBER_WRONG, place)
    for point in motion.points:
        need(not beyond(robot, point), Code.ANSWER_WRONG, "question.motion.points")
    for (t, before), (u, after) in pairwise(zip(motion.times, motion.points, strict=True)):
        for a, b, limit in zip(before, after, robot.speed_limits, strict=True):
            need(abs(b - a) <= limit * (u - t) * (1 + SAME), Code.ANSWER_WRONG, "question.motion.points")
    curve = _curve(motion)
    return tuple(_between(curve, t, u) for t, u in pairwise([0.0, *times]))


def _curve(motion: CheckerTrajectory) -> list[_Stretch]:
    """The curve through the points.

    Each joint's speed changes evenly to that of the middle of the time, and again to the next point's.
    """
    speeds = motion.speeds or _even(motion)
    found: list[_Stretch] = []
    rows = list(zip(motion.times, motion.points, speeds, strict=True))
    for (t, q, v), (u, p, w) in pairwise(rows):
        half = (u - t) / 2
        middle = tuple((b - a) / half - (x + y) / 2 for a, b, x, y in zip(q, p, v, w, strict=True))
        first = tuple((m - x) / half for m, x in zip(middle, v, strict=True))
        second = tuple((y - m) / half for m, y in zip(middle, w, strict=True))
        begun = _Stretch(t, t + half, q, v, first)
        there, _ = begun.at(t + half)
        found += [begun, _Stretch(t + half, u, there, middle, second)]
    return found


def _even(motion: CheckerTrajectory) -> list[Six]:
    """Speeds at the points where none are stated: the harmonic mean of both sides, and 0 where they turn."""
    rows = list(zip(motion.times, motion.points, strict=True))
    means = [tuple((b - a) / (u - t) for a, b in zip(q, p, strict=True)) for (t, q), (u, p) in pairwise(rows)]
    inner = [
        tuple(2 * a * b / (a + b) if a * b > 0 else 0.0 for a, b in zip(before, after, strict=True))
        for before, after in pairwise(means)
    ]
    return [NONE, *inner, NONE]


def _between(curve: Sequence[_Stretch], since: float, until: float) -> CheckerTimedPiece:
    """All that the trajectory does between two times, and how its servo may follow it."""
    met = [each for each in curve if each.until > since and each.since < until]
    begin, end = met[0].at(since)[0], met[-1].at(until)[0]
    even = tuple((b - a) / (until - since) for a, b in zip(begin, end, strict=True))
    beside, uneven = [0.0] * JOINTS, [0.0] * JOINTS
    for each in met:
        low, high = max(each.since, since), min(each.until, until)
        sag = [abs(a) * (high - low) ** 2 / 8 for a in each.a]  # a parabola over its chord
        for time in (low, high):
            q, v = each.at(time)
            for j in range(JOINTS):
                beside[j] = max(beside[j], abs(q[j] - begin[j] - even[j] * (time - since)) + sag[j])
                uneven[j] = max(uneven[j], abs(v[j] - even[j]))
    around = [each.a for each in curve if each.until > since - LAG_S and each.since < until + LAG_S]
    hardest = tuple(max(abs(a[j]) for a in around) for j in range(JOINTS))
    return CheckerTimedPiece(
        start=begin,
        seconds=until - since,
        speed=even,
        tube=tuple(b + a * LAG_S * LAG_S / 2 + HOLD_RAD for b, a in zip(beside, hardest, strict=True)),
        hurry=tuple(u + a * LAG_S / 2 + HOLD_RAD_S for u, a in zip(uneven, hardest, strict=True)),
        acceleration=hardest,
    )


def timed_piece(
    robot: CheckerRobot, cell: Cell, piece: CheckerTimedPiece, row: dict[str, Any]
) -> CheckerTimedCourse | FixedAnswer:
    """Course of a piece until a stop that begins on it has ended.

    The question and the times of the piece determine it.

    Raises:
        Refusal: something is recorded.
    """
    fastest = max(abs(v) + h for v, h in zip(piece.speed, piece.hurry, strict=True))
    braking = cell.stop_deceleration_rad_s2 / fastest
    stop_s = RIPPLE * RIPPLE / (2 * braking)
    seconds = piece.seconds + stop_s
    way = tuple(seconds * v for v in piece.speed)
    stray = tuple(t + stop_s * h for t, h in zip(piece.tube, piece.hurry, strict=True))
    tail = Tail(0, piece.start, way)
    if beyond(robot, piece.start, stray) or beyond(robot, tail.at(GRID)[0], stray):
        return fixed(row, PAST_LIMIT)
    types = type(row["until"]) is int and type(row["limit"]) is bool
    need(types and row == NOT_TRACED, Code.MEMBER_WRONG, PLACE)
    straight, step = tuple(map(abs, way)), GRID // ENVELOPE
    bend = tuple(a * seconds * seconds for a in piece.acceleration)
    hurry = tuple(seconds * h for h in piece.hurry)
    bounds = [
        CheckerPieceBounds(low, low + step, way, bend, straight, NONE, NONE, stray, hurry)
        for low in range(0, GRID, step)
    ]
    timing = Timing(seconds, RIPPLE, AT_ONCE, braking)
    push = (braking / seconds, braking / seconds)
    end = tuple(q + piece.seconds * v for q, v in zip(piece.start, piece.speed, strict=True))
    return CheckerTimedCourse(CheckerCourse(robot, bounds, {}, tail), timing, push, 0.0, end)

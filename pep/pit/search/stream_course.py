"""Streams as drives: a held tool speed and a servo target, each through the stop that ends it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import MotionError, UnprovenError
from pep.pit.base.motion import Profile
from pep.pit.path.course import Cells, straight_cells
from pep.pit.path.course_angles import Track
from pep.pit.path.line_trace import CutShort
from pep.pit.path.straight_path import GRID
from pep.pit.robot.twist import Twist, tool_pose
from pep.pit.search.engine import chosen
from pep.pit.search.timed_course import Nowhere, PastLimit, TimedCourse, beyond, ended, fastest_of, unbounded

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Floats, ServoJ, SpeedL
    from pep.pit.path.line_trace import LineTrace
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.kernel.compiled_course import CompiledCourse
    from pep.pit.search.timed_course import Drive

STEPS: Final = 1024  # the end of a hold lies on one of so many places of a course, so that its pieces halve evenly
WINDOW_PIECES: Final = 16  # of the end of a hold: the stray there is as large as the bound of the bending
ROOM: Final = 1.01  # the joints' speeds where a hold ends may differ by so much between two places 1 / STEPS apart
PLANS: Final = 4  # the hold ends a little later for lying on the grid, where the joints may be a little faster
AT_ONCE: Final = 1e12  # acceleration of a motion under way: it has its speed from the first instant
LOOKAHEAD_LEAST_S: Final = 0.03  # U12: the least lookahead of servoJ
ENVELOPE_CELLS: Final = 8  # of a straight envelope, which bends nowhere
STILL_RAD_S: Final = 1e-6  # one unit of the wire (urad/s)


@dataclass(frozen=True, slots=True)
class _Ramp:
    """Tool speed from rest, in seconds at full speed; `up` is its growth, 1/s."""

    up: float

    def way(self, until_s: float) -> float:
        """Way so far."""
        ramp = min(1 / self.up, until_s)
        return self.up * ramp * (until_s - 0.5 * ramp)

    def share(self, until_s: float) -> float:
        """Share of the full speed."""
        return min(1.0, self.up * until_s)


@dataclass(frozen=True, slots=True)
class _Plan:
    """Plan of a held speed's end on its course.

    Attributes:
        seconds: the whole course, the stop included, in seconds at full speed.
        end: latest place where the stop takes hold, in 1 / GRID.
        window: range before it where it may do so, by the course's own parameter.
        stop: way of a stop there per unit of the fastest joint's derivative, by the course's own parameter.
    """

    seconds: float
    end: int
    window: float
    stop: float


def speed_drive(robot: Robot, motion: SpeedL, cell: CellParameters, *, check_time: Callable[[], None]) -> Drive:
    """A tool velocity from rest, held until its stop takes hold, and then the joints' own stop along their tangent.

    Everything is measured in seconds at full speed. The stop may take hold anywhere between the end of the hold and
    `stop_delay_s` later: what it may then leave the course by is added to the course (PHY-19).

    Raises:
        UnprovenError: it could not be traced to its end, nobody says how speed and turning grow together, or how far
            the stop may take.
    """
    full, start = np.array(motion.twist), np.array(motion.start)
    largest = float(np.abs(full).max())
    if not largest > 0:
        return Nowhere()
    if beyond(robot, start):
        return PastLimit()
    if full[:3].any() and full[3:].any():
        raise UnprovenError("uneven_twist")
    ramp = _Ramp(motion.acceleration_m_s2 / largest)
    held = motion.duration_s + cell.stop_delay_s
    peak = ramp.share(held)
    position, rotation = tool_pose(robot, start)

    def twist_for(seconds: float) -> Twist:
        return Twist(position, rotation, seconds * full[:3], seconds * full[3:])

    def ends(seconds: float, found: CutShort) -> PastLimit:
        profile = Profile(seconds, 1.0, ramp.up, AT_ONCE)
        return ended(robot, twist_for(seconds), profile, found, ramp.up / seconds)

    # 1. Where the hold ends, and how fast the joints are there: that is how far their stop takes.
    hold = ramp.way(held)
    first = chosen().trace(robot, twist_for(hold), start, fastest=fastest_of(robot, 1 / hold), check_time=check_time)
    if isinstance(first, CutShort):
        return ends(hold, first)
    sent, cells = ramp.way(motion.duration_s), first.cells
    late = cells.high / GRID * hold > sent
    leading = float(cells.first[-1].max()) / hold
    bending = float(cells.second[late].max()) / (hold * hold)
    plan = _planned(hold, sent, leading, bending, stop=peak * peak / (2 * cell.stop_deceleration_rad_s2))
    # 2. The same with the end of the hold on the grid, a little later rather than earlier.
    twist = twist_for(plan.seconds)
    line = _line_and_window(robot, twist, start, plan, check_time)
    if isinstance(line, CutShort):
        return ends(plan.seconds, line)
    # 3. The stop, and what one that takes hold earlier leaves the course by.
    course = _stopped(robot, twist, line, plan)
    s_end = plan.end / GRID
    braking = peak * peak / (2 * (1 - s_end) * plan.seconds)
    drive = TimedCourse(
        course,
        Profile(plan.seconds, 1.0, ramp.up, braking),
        (ramp.up / plan.seconds, braking / plan.seconds),
        tool_speed_m_s=float(np.linalg.norm(full[:3])),
        slower=False,
    )
    return PastLimit(drive) if beyond(robot, course.q(1.0), course.cells.stray[-1]) else drive


def _planned(hold: float, sent: float, leading: float, bending: float, *, stop: float) -> _Plan:
    """Plan of a hold that ends after `hold` seconds, for each beginning of its stop from `sent` on.

    Args:
        hold: at full speed, s.
        sent: likewise.
        leading: speed of the fastest joint at the end of the hold, rad/s.
        bending: growth of that speed with an earlier stop, rad/s2.
        stop: seconds at full speed that the stop takes per rad/s.
    """
    # From where it takes hold the arm stops within stop * speed; an earlier one ends earlier, or the course is longer.
    travel = max(stop * ROOM * leading, stop * (leading + bending * (hold - sent)) - (hold - sent))
    place, travel = _on_grid(hold, travel)
    for _ in range(PLANS):
        later = travel * place / (STEPS - place) - hold
        needed = stop * (leading + bending * later)
        if needed <= travel:
            break
        place, travel = _on_grid(hold, needed)
    seconds = travel * STEPS / (STEPS - place)
    return _Plan(seconds, place * (GRID // STEPS), place / STEPS - sent / seconds, stop / (seconds * seconds))


def _on_grid(hold: float, travel: float) -> tuple[int, float]:
    """Place, of `STEPS`, where a hold ends whose stop takes `travel` s; a short travel is lengthened."""
    place = math.ceil(STEPS * hold / (hold + travel))
    return (place, travel) if place < STEPS else (STEPS - 1, hold / (STEPS - 1))


def _late(plan: _Plan) -> int:
    """Earliest place where the stop may take hold, in 1 / GRID."""
    return max(0, math.floor((plan.end / GRID - plan.window) * STEPS)) * (GRID // STEPS)


def _line_and_window(
    robot: Robot, twist: Twist, start: Floats, plan: _Plan, check_time: Callable[[], None]
) -> LineTrace | CutShort:
    """The line until the stop takes hold, in small pieces where it may: there the bending counts most."""
    late, fastest = _late(plan), fastest_of(robot, 1 / plan.seconds)
    cells, here = Cells.joined([]), start
    if late > 0:
        before = chosen().trace(robot, twist, start, until=late, fastest=fastest, check_time=check_time)
        if isinstance(before, CutShort):
            return before
        cells, here = before.cells, before.q
    after = chosen().trace(
        robot,
        twist,
        here,
        since=late,
        until=plan.end,
        pieces=WINDOW_PIECES,
        fastest=fastest,
        check_time=check_time,
    )
    return replace(after, cells=Cells.joined([cells, after.cells]))


def _stopped(robot: Robot, twist: Twist, line: LineTrace, plan: _Plan) -> CompiledCourse:
    """The line, and after it the joints' tangent; what an earlier stop leaves them by is their stray and hurry.

    Raises:
        UnprovenError: the joints' speeds change so fast there that the stop's way cannot be told.
    """
    s_end, cells, dq = plan.end / GRID, line.cells, line.dq
    late = cells.high > _late(plan)
    bend = cells.second[late].max(axis=0)
    stray = bend * (0.5 * plan.window**2 + plan.window * (1 - s_end))
    hurry = bend * plan.window
    cells = replace(
        cells,
        stray=np.where(late[:, None], cells.stray + stray, cells.stray),
        hurry=np.where(late[:, None], cells.hurry + hurry, cells.hurry),
    )
    for earlier in (0.0, plan.window):
        if not s_end - earlier + plan.stop * float((np.abs(dq) + bend * earlier).max()) <= 1:
            raise UnprovenError("singular")
    tail = straight_cells(line.q, dq, low=plan.end, stray=cells.stray[-1], hurry=hurry)
    tail = replace(tail, third=unbounded(tail))
    return chosen().course(robot, Cells.joined([cells, tail]), Track(twist, s_end, line.q, dq))


def servo_drive(robot: Robot, motion: ServoJ, cell: CellParameters, *, reaction_s: float) -> Drive:
    """Everywhere a servo target may take the arm until a stop after it has ended.

    Each joint's speed lies between the measured one and what makes for the target within the lookahead; it goes on for
    the reaction, one period and the stop's delay, and then falls at the stop's deceleration (PHY-20).

    Args:
        robot: the arm.
        motion: the target, and how the arm moves.
        cell: its stop model.
        reaction_s: from an event to the stop that follows.

    Raises:
        MotionError: `ROBOT_LIMIT`, no joint may go so fast as this jump asks.
    """
    start, now = np.array(motion.start), np.array(motion.qd_rad_s)
    jump = np.array(motion.target) - start
    lookahead = max(motion.lookahead_s, LOOKAHEAD_LEAST_S)
    if not (np.abs(jump) <= robot.speed_limits_rad_s * (motion.period_s + lookahead)).all():
        raise MotionError("ROBOT_LIMIT", "the target is farther than the arm can follow")
    asked = jump / lookahead
    fastest = max(float(np.abs(now).max()), float(np.abs(asked).max()))
    if not fastest > STILL_RAD_S:
        return Nowhere()
    held = reaction_s + motion.period_s + cell.stop_delay_s
    braking = cell.stop_deceleration_rad_s2 / fastest
    seconds = held + 1 / (2 * braking)
    middle, spread = seconds * 0.5 * (now + asked), seconds * 0.5 * np.abs(now - asked)
    cells = straight_cells(start, middle, low=0, stray=spread, hurry=spread, count=ENVELOPE_CELLS)
    if beyond(robot, start, spread) or beyond(robot, start + middle, spread):
        return PastLimit()
    profile = Profile(seconds, 1.0, AT_ONCE, braking)
    course = chosen().course(robot, cells, Track(None, 0.0, start, middle))
    return TimedCourse(course, profile, (braking / seconds, braking / seconds), slower=False)

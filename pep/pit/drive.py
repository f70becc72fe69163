"""A motion that is no straight run, as a course with its timing: a line of the tool, a held tool speed, a servo target.

What cannot be traced to its end is a drive as far as it was traced, with the word for why it ends there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from pep.pit.course import Cells, Course, straight_cells
from pep.pit.errors import MotionError
from pep.pit.inverse import solved
from pep.pit.line import FINEST, Trace, pose_exists, trace
from pep.pit.motion import STILL_RAD, Profile
from pep.pit.path import GRID
from pep.pit.twist import HALF_TURN_RAD, Twist, tool_pose, turn_of, turned_by

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats, Joints, Pose, ServoJ, SpeedL
    from pep.pit.robot import Robot

    Check = Callable[[], None]

Doubt = Literal["singular", "unreachable", "joint_limit", "half_turn", "uneven_twist"]
"""Why a motion is not proven to its end: a joint is too fast for any bound, no joint angles were found, a joint limit
is met, it is not known which way round the tool turns, or how speed and turning grow together."""

STATED_M: Final = 0.002  # DESIGN section 6 of the reference's committed state: 2 mm
STATED_RAD: Final = 0.002  # likewise: 2 mrad
TOO_FAST: Final = 4.0  # times a joint's limit: index 4 whatever else is proven (PHY-7), so nothing more is
UNBOUNDED: Final = 1e30  # rad per s^3: more than any other bound allows, and no infinity, which times 0 is none
STEPS: Final = 1024  # the end of a hold lies on one of so many places of a course, so that its pieces halve evenly
AT_ONCE: Final = 1e12  # acceleration of what is under way already: it has its speed from the first instant
LOOKAHEAD_LEAST_S: Final = 0.03  # U12: the least lookahead of servoJ
ROOM: Final = 1.01  # the joints' speeds where a hold ends may differ by so much between two places 1 / STEPS apart
WINDOW_PIECES: Final = 16  # of the end of a hold: what strays there is as much as its bound of the bending
ENVELOPE_CELLS: Final = 8  # of a straight envelope, which bends nowhere
STILL_RAD_S: Final = 1e-6  # one unit of the wire (urad/s)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A course with its timing.

    Attributes:
        course: where the joints go.
        profile: how fast; its lengths are metres for a line and seconds at full speed for a held one.
        push: greatest second derivative of the path parameter by time that the motion itself asks for, 1/s^2, forward
            and backward.
        tool_speed_m_s: that is commanded for the tool point, 0 when none is.
        slower: whether another commanded speed is the same motion, only slower.
        doubt: why it ends before the motion does, or None.
        twist: the line of the tool that it follows, by the course's own parameter, or None when there is none.
        line_until: as far as it does.
    """

    course: Course
    profile: Profile
    push: tuple[float, float]
    tool_speed_m_s: float = 0.0
    slower: bool = True
    doubt: Doubt | None = None
    twist: Twist | None = None
    line_until: float = 1.0

    def at_speed(self, speed: float) -> Profile:
        """The timing at another commanded speed."""
        return replace(self.profile, speed_rad_s=speed)

    def joint_speeds_rad_s(self, profile: Profile) -> Floats:
        """Proven bound on the speed of each joint on each cell, (cells, 6)."""
        cells = self.course.cells
        rate = profile.highest_rate(cells.low / GRID, cells.high / GRID)
        return np.asarray((cells.first + cells.hurry) * rate[:, None])


@dataclass(frozen=True, slots=True)
class Nowhere:
    """A motion that leaves the arm where it stands, or of which nothing could be traced.

    Attributes:
        doubt: why nothing was, or None when it is no motion.
    """

    doubt: Doubt | None = None


def _beyond(robot: Robot, q: Floats) -> bool:
    """Whether a joint is beyond its limit. A stuck arm comes back by a joint move, whose retreat is proven."""
    return bool((np.abs(q) > robot.position_limits_rad).any())


def _on(robot: Robot, twist: Twist, s: float, near: Floats) -> tuple[Floats, Floats]:
    """The joint angles of a proven line at `s`, and their derivative by s."""
    here = solved(robot, twist.at(s), near)
    if here is None:
        raise MotionError("PHYSICS_FAULT", "a proven line was not found again")
    return here.q, np.asarray(np.linalg.solve(here.jacobian, twist.rate))


def _line_course(robot: Robot, cells: list[Cells], twist: Twist) -> Course:
    return Course(robot, Cells.joined(cells), lambda s, near: _on(robot, twist, s, near))


def line_drive(
    robot: Robot,
    start: Joints,
    target: Pose,
    *,
    speed_m_s: float,
    acceleration_m_s2: float,
    stated: Pose | None = None,
    check_time: Check,
) -> Drive | Nowhere:
    """A line of the tool from rest to rest.

    Raises:
        MotionError: `FRAMES_MISMATCH`, the stated pose of the tool is not the model's at `start`.
    """
    if _beyond(robot, np.array(start)):
        return Nowhere("joint_limit")
    twist = Twist.between(robot, start, target)
    if stated is not None:
        off = turn_of(turned_by(np.array(stated[3:])) @ twist.rotation.T)
        if not (
            np.linalg.norm(np.array(stated[:3]) - twist.position) <= STATED_M and np.linalg.norm(off) <= STATED_RAD
        ):
            raise MotionError("FRAMES_MISMATCH", "the tool is not where the model has it at these joint angles")
    if not twist.way_m > STILL_RAD:
        return Nowhere()
    profile = Profile(twist.way_m, speed_m_s, acceleration_m_s2)
    if not np.linalg.norm(twist.turn) <= HALF_TURN_RAD:
        return Nowhere("half_turn")
    tool = speed_m_s * float(np.linalg.norm(twist.line)) / twist.way_m
    drive = _traced(robot, twist, np.array(start), profile, check_time)
    return replace(drive, tool_speed_m_s=tool) if isinstance(drive, Drive) else drive


def _fastest(robot: Robot, highest_rate: float) -> Floats:
    """Rates of the joints by s, at which none is of any use when s grows at `highest_rate`, 1/s."""
    return np.asarray(TOO_FAST * robot.speed_limits_rad_s / highest_rate)


def _traced(robot: Robot, twist: Twist, start: Floats, profile: Profile, check_time: Check) -> Drive | Nowhere:
    """The line as a drive, or as much of it as can be proven."""
    fastest = _fastest(robot, profile.peak_rad_s / profile.way_rad)
    found = trace(robot, twist, start, fastest=fastest, check_time=check_time)
    push = profile.acceleration_rad_s2 / profile.way_rad
    if found.stuck is not None:
        return _begun(robot, twist, profile, found, push)
    return Drive(_line_course(robot, found.cells, twist), profile, (push, push), twist=twist)


def _begun(robot: Robot, twist: Twist, profile: Profile, found: Trace, push: float) -> Drive | Nowhere:
    """What was proven of a line that gets stuck; from there the course comes to rest within one finest piece."""
    assert found.stuck is not None
    doubt: Doubt = found.stuck
    if found.stuck == "singular" and not pose_exists(robot, twist, found.reached):
        doubt = "unreachable"
    if not found.cells:
        return Nowhere(doubt)
    s_end = found.reached / GRID
    last = solved(robot, twist.at(s_end), found.cells[-1].q[0])
    if last is None:
        return Nowhere(doubt)
    dq: Floats = np.asarray(np.linalg.solve(last.jacobian, twist.rate))
    width = min(FINEST, GRID - found.reached)
    fade = width / GRID
    still = np.zeros(len(dq))
    slowing = straight_cells(last.q, dq, low=found.reached, high=found.reached + width, stray=still, hurry=still)
    slowing = replace(slowing, second=np.abs(dq)[None] / fade, third=_unbounded(slowing))
    cells = [*found.cells, slowing]
    if found.reached + width < GRID:
        resting = straight_cells(last.q + 0.5 * fade * dq, still, low=found.reached + width, stray=still, hurry=still)
        cells.append(replace(resting, third=_unbounded(resting)))

    def solve(s: float, near: Floats) -> tuple[Floats, Floats]:
        if s <= s_end:
            return _on(robot, twist, s, near)
        on = min(s - s_end, fade)
        return last.q + (on - 0.5 * on * on / fade) * dq, (1 - on / fade) * dq

    course = Course(robot, Cells.joined(cells), solve)
    return Drive(course, profile, (push, push), slower=False, doubt=doubt, twist=twist, line_until=s_end)


def _unbounded(cells: Cells) -> Floats:
    """Third derivatives of cells where the second jumps at their ends: only the second says anything there."""
    return np.full_like(cells.third, UNBOUNDED)


def speed_drive(robot: Robot, motion: SpeedL, cell: CellParameters, *, check_time: Check) -> Drive | Nowhere:
    """A tool velocity from rest, held until its stop takes hold, and then the joints' own stop along their tangent.

    Everything is measured in seconds at full speed. The stop may take hold anywhere between the end of the hold and
    `stop_delay_s` later: what it may then leave the course by is added to the course (PHY-19).
    """
    full = np.array(motion.twist)
    largest = float(np.abs(full).max())
    if not largest > 0:
        return Nowhere()
    start = np.array(motion.start)
    if _beyond(robot, start):
        return Nowhere("joint_limit")
    up = motion.acceleration_m_s2 / largest
    sent, held = motion.duration_s, motion.duration_s + cell.stop_delay_s

    def way(until_s: float) -> float:
        ramp = min(1 / up, until_s)
        return up * ramp * (until_s - 0.5 * ramp)

    peak = min(1.0, up * held)
    position, rotation = tool_pose(robot, start)
    uneven: Doubt | None = "uneven_twist" if full[:3].any() and full[3:].any() else None

    def twist_for(seconds: float) -> Twist:
        return Twist(position, rotation, seconds * full[:3], seconds * full[3:])

    def begun(seconds: float, found: Trace) -> Drive | Nowhere:
        return _begun(robot, twist_for(seconds), Profile(seconds, 1.0, up, AT_ONCE), found, up / seconds)

    # 1. Where the hold ends, and how fast the joints are there: that is how far their stop takes.
    hold = way(held)
    first = trace(robot, twist_for(hold), start, fastest=_fastest(robot, 1 / hold), check_time=check_time)
    if first.stuck is not None:
        return begun(hold, first)
    leading = ROOM * float(np.abs(first.cells[-1].first).max()) / hold
    travel = peak * peak * leading / (2 * cell.stop_deceleration_rad_s2)
    # 2. The same with the end of the hold on the grid, a little later rather than earlier.
    place = math.ceil(STEPS * hold / (hold + travel))
    if place >= STEPS:
        place, travel = STEPS - 1, hold / (STEPS - 1)
    seconds = travel * STEPS / (STEPS - place)
    end = place * (GRID // STEPS)
    twist = twist_for(seconds)
    s_end = end / GRID
    window = s_end - way(sent) / seconds
    late = max(0, math.floor((s_end - window) * STEPS)) * (GRID // STEPS)
    fastest = _fastest(robot, 1 / seconds)
    line = Trace([], 0, None)
    if late > 0:
        line = trace(robot, twist, start, until=late, fastest=fastest, check_time=check_time)
    here = start
    if late > 0 and line.stuck is None:
        found = solved(robot, twist.at(late / GRID), line.cells[-1].q[0])
        here = start if found is None else found.q
    final = trace(
        robot, twist, here, since=late, until=end, pieces=WINDOW_PIECES, fastest=fastest, check_time=check_time
    )
    for part in (line, final):
        if part.stuck is not None:
            proven = line.cells if part is line else [*line.cells, *final.cells]
            return begun(seconds, Trace(proven, part.reached, part.stuck))
    cells = Cells.joined([*line.cells, *final.cells])
    last = solved(robot, twist.at(s_end), cells.q[-1])
    if last is None:
        return Nowhere("singular")
    dq: Floats = np.asarray(np.linalg.solve(last.jacobian, twist.rate))
    # 3. What a stop that takes hold earlier leaves the course by.
    late_cells = cells.high > late
    bend = cells.second[late_cells].max(axis=0)
    stray = bend * (0.5 * window**2 + window * (1 - s_end))
    hurry = bend * window
    cells = replace(
        cells,
        stray=np.where(late_cells[:, None], cells.stray + stray, cells.stray),
        hurry=np.where(late_cells[:, None], cells.hurry + hurry, cells.hurry),
    )
    if not np.abs(dq).max() <= leading * seconds:
        return Nowhere("singular")  # the joints' speeds change so fast there that the stop's way cannot be told
    if _beyond(robot, np.abs(last.q + (1 - s_end) * dq) + cells.stray[-1]):
        return Nowhere("joint_limit")
    tail = straight_cells(last.q, dq, low=end, stray=cells.stray[-1], hurry=hurry)
    tail = replace(tail, third=_unbounded(tail))

    def solve(s: float, near: Floats) -> tuple[Floats, Floats]:
        return _on(robot, twist, s, near) if s <= s_end else (last.q + (s - s_end) * dq, dq)

    braking = peak * peak / (2 * (1 - s_end) * seconds)
    profile = Profile(seconds, 1.0, up, braking)
    course = Course(robot, Cells.joined([cells, tail]), solve)
    return Drive(
        course,
        profile,
        (up / seconds, braking / seconds),
        tool_speed_m_s=float(np.linalg.norm(full[:3])),
        slower=False,
        doubt=uneven,
        twist=twist,
        line_until=s_end,
    )


def servo_drive(robot: Robot, motion: ServoJ, cell: CellParameters, *, reaction_s: float) -> Drive | Nowhere:
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
    if _beyond(robot, np.maximum(np.abs(start), np.abs(start + middle)) + spread):
        return Nowhere("joint_limit")

    def solve(s: float, near: Floats) -> tuple[Floats, Floats]:
        del near
        return start + s * middle, middle

    profile = Profile(seconds, 1.0, AT_ONCE, braking)
    return Drive(Course(robot, cells, solve), profile, (braking / seconds, braking / seconds), slower=False)

"""Motion that is no straight run, as a course with its timing; and a line of the tool as one.

A line that cannot be traced to its end is a drive as far as it was traced, with the reason of its end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from pep.pit.base.errors import MotionError
from pep.pit.base.motion import STILL_RAD, Profile
from pep.pit.path.course import Cells, straight_cells
from pep.pit.path.course_angles import Track
from pep.pit.path.line_trace import FINEST
from pep.pit.path.straight_path import GRID
from pep.pit.robot.twist import HALF_TURN_RAD, Twist, turn_of, turned_by
from pep.pit.search.engine import chosen

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Floats, Joints, Pose
    from pep.pit.path.line_trace import LineTrace
    from pep.pit.robot.robot import Robot
    from pep.pit.search.kernel.compiled_course import CompiledCourse

    Check = Callable[[], None]

Doubt = Literal["singular", "unreachable", "joint_limit", "half_turn", "uneven_twist"]
"""Reason why a motion is not proven to its end.

A joint is too fast for any bound, no joint angles were found, a joint limit is met, the tool's direction of turn is
unknown, or the proportion of speed and turn is.
"""

STATED_M: Final = 0.002  # DESIGN section 6 of the reference's committed state: 2 mm
STATED_RAD: Final = 0.002  # likewise: 2 mrad
TOO_FAST: Final = 4.0  # times a joint's limit: index 4 in any case (PHY-7), so nothing more is proven
UNBOUNDED: Final = 1e30  # rad per s^3: more than any other bound allows, and no infinity, which times 0 is none


@dataclass(frozen=True, slots=True, eq=False)
class TimedCourse:
    """A course with its timing.

    Attributes:
        course: path of the joints.
        profile: its timing; its lengths are metres for a line and seconds at full speed for a held one.
        push: greatest second derivative of the path parameter by time that the motion itself asks for, 1/s^2, forward
            and backward.
        tool_speed_m_s: that is commanded for the tool point, 0 when none is.
        slower: whether another commanded speed is the same motion, only slower.
        doubt: reason why it ends before the motion does, or None.
    """

    course: CompiledCourse
    profile: Profile
    push: tuple[float, float]
    tool_speed_m_s: float = 0.0
    slower: bool = True
    doubt: Doubt | None = None

    @property
    def twist(self) -> Twist | None:
        """Line of the tool that it follows, by the course's own parameter, or None without one."""
        return self.course.track.twist

    @property
    def line_until(self) -> float:
        """End of the followed line; 1 without one."""
        return 1.0 if self.course.track.twist is None else self.course.track.until

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
    """Motion that leaves the arm at its place, or of which nothing could be traced.

    Attributes:
        doubt: reason why nothing was traced, or None when it is no motion.
    """

    doubt: Doubt | None = None


def beyond(robot: Robot, q: Floats, around: Floats | float = 0.0) -> bool:
    """True where a joint may be beyond its range when each is within `around` (6,) of `q` (6,), rad.

    A stuck arm comes back by a joint move, whose retreat is proven.
    """
    low, high = robot.position_ranges_rad
    return not bool(((low <= q - around) & (q + around <= high)).all())


def line_drive(
    robot: Robot,
    start: Joints,
    target: Pose,
    *,
    speed_m_s: float,
    acceleration_m_s2: float,
    stated: Pose | None = None,
    check_time: Check,
) -> TimedCourse | Nowhere:
    """A line of the tool from rest to rest.

    Raises:
        MotionError: `FRAMES_MISMATCH`, the stated pose of the tool is not the model's at `start`.
    """
    if beyond(robot, np.array(start)):
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
    return replace(drive, tool_speed_m_s=tool) if isinstance(drive, TimedCourse) else drive


def fastest_of(robot: Robot, highest_rate: float) -> Floats:
    """Rates of the joints by s above which no bound is of use when s grows at `highest_rate`, 1/s."""
    return np.asarray(TOO_FAST * robot.speed_limits_rad_s / highest_rate)


def _traced(robot: Robot, twist: Twist, start: Floats, profile: Profile, check_time: Check) -> TimedCourse | Nowhere:
    """Line as a drive, or its provable part."""
    fastest = fastest_of(robot, profile.peak_rad_s / profile.way_rad)
    found = chosen().trace(robot, twist, start, fastest=fastest, check_time=check_time)
    push = profile.acceleration_rad_s2 / profile.way_rad
    if found.stuck is not None:
        return begun(robot, twist, profile, found, push)
    course = chosen().course(robot, found.cells, Track(twist, 1.0, found.q, found.dq))
    return TimedCourse(course, profile, (push, push))


def begun(robot: Robot, twist: Twist, profile: Profile, found: LineTrace, push: float) -> TimedCourse | Nowhere:
    """Proven part of a line that gets stuck; there the course comes to rest within one finest piece."""
    assert found.stuck is not None
    doubt: Doubt = found.stuck
    if found.stuck == "singular" and not chosen().pose_exists(robot, twist, found.reached):
        doubt = "unreachable"
    if not len(found.cells):
        return Nowhere(doubt)
    s_end, q, dq = found.reached / GRID, found.q, found.dq
    width = min(FINEST, GRID - found.reached)
    fade = width / GRID
    still = np.zeros(len(dq))
    slowing = straight_cells(q, dq, low=found.reached, high=found.reached + width, stray=still, hurry=still)
    slowing = replace(slowing, second=np.abs(dq)[None] / fade, third=unbounded(slowing))
    cells = [found.cells, slowing]
    if found.reached + width < GRID:
        resting = straight_cells(q + 0.5 * fade * dq, still, low=found.reached + width, stray=still, hurry=still)
        cells.append(replace(resting, third=unbounded(resting)))
    course = chosen().course(robot, Cells.joined(cells), Track(twist, s_end, q, dq, fade))
    return TimedCourse(course, profile, (push, push), slower=False, doubt=doubt)


def unbounded(cells: Cells) -> Floats:
    """Vacuous bounds on the third derivative, for cells where the second jumps at their ends."""
    return np.full_like(cells.third, UNBOUNDED)

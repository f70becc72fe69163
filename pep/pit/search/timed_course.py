"""Motion that is no straight run, as a course with its timing; and a line of the tool as one.

A course goes to the motion's end. What cannot be proven to there is no course, but the error `UNPROVEN`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import MotionError, UnprovenError
from pep.pit.base.motion import STILL_RAD, Profile
from pep.pit.path.course import Cells, straight_cells
from pep.pit.path.course_angles import Track
from pep.pit.path.line_trace import CutShort
from pep.pit.path.straight_path import GRID
from pep.pit.robot.inverse_kinematics import reaches
from pep.pit.robot.twist import HALF_TURN_RAD, Twist, turn_of, turned_by
from pep.pit.search.engine import chosen

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Floats, Joints, Pose
    from pep.pit.robot.robot import Robot
    from pep.pit.search.kernel.compiled_course import CompiledCourse

    Check = Callable[[], None]

STATED_M: Final = 0.002  # DESIGN section 6 of the reference's committed state: 2 mm
STATED_RAD: Final = 0.002  # likewise: 2 mrad
TOO_FAST: Final = 4.0  # times a joint's limit: index 4 in any case (PHY-7), so nothing more is proven
UNBOUNDED: Final = 1e30  # rad per s^3: more than any other bound allows, and no infinity, which times 0 is none


@dataclass(frozen=True, slots=True, eq=False)
class TimedCourse:
    """A course with its timing, from where the motion departs to where it ends.

    Attributes:
        course: path of the joints.
        profile: its timing; its lengths are metres for a line and seconds at full speed for a held one.
        push: greatest second derivative of the path parameter by time that the motion itself asks for, 1/s^2, forward
            and backward.
        tool_speed_m_s: that is commanded for the tool point, 0 when none is.
        slower: whether another commanded speed is the same motion, only slower.
        least_s: time that the arm takes between the blends at its ends, at least, s; 0 where that is not known. Of a
            corner its first course has all of it.
        joined: whether the course after it is of the same corner.
        onward_rad_s: speed of a joint on what the arm goes on to without rest, at most; 0 where it rests.
    """

    course: CompiledCourse
    profile: Profile
    push: tuple[float, float]
    tool_speed_m_s: float = 0.0
    slower: bool = True
    least_s: float = 0.0
    joined: bool = False
    onward_rad_s: float = 0.0

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

    def leading_rad_s(self, profile: Profile) -> float:
        """Speed of a joint from which a stop may have to bring it to rest."""
        return max(float(self.joint_speeds_rad_s(profile).max()), self.onward_rad_s)


@dataclass(frozen=True, slots=True)
class Nowhere:
    """A motion that leaves the arm where it stands."""


@dataclass(frozen=True, slots=True, eq=False)
class PastLimit:
    """Motion that goes beyond a joint's limit, or comes from there; no authority permits it.

    Attributes:
        shown: the motion up to the limit, for a proof; None where it begins beyond one, or all of it may be there.
    """

    shown: TimedCourse | None = None


Drive = TimedCourse | Nowhere | PastLimit


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
) -> Drive:
    """A line of the tool from rest to rest.

    Raises:
        MotionError: `FRAMES_MISMATCH`, the stated pose of the tool is not the model's at `start`.
        UnprovenError: it could not be traced to its end, or nobody says which way round the tool turns.
    """
    if beyond(robot, np.array(start)):
        return PastLimit()
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
        raise UnprovenError("half_turn")
    tool = speed_m_s * float(np.linalg.norm(twist.line)) / twist.way_m
    drive = _traced(robot, twist, np.array(start), profile, check_time)
    return replace(drive, tool_speed_m_s=tool) if isinstance(drive, TimedCourse) else drive


def fastest_of(robot: Robot, highest_rate: float) -> Floats:
    """Rates of the joints by s above which no bound is of use when s grows at `highest_rate`, 1/s."""
    return np.asarray(TOO_FAST * robot.speed_limits_rad_s / highest_rate)


def _traced(robot: Robot, twist: Twist, start: Floats, profile: Profile, check_time: Check) -> TimedCourse | PastLimit:
    """The line as a course with its timing."""
    fastest = fastest_of(robot, profile.peak_rad_s / profile.way_rad)
    found = chosen().trace(robot, twist, start, fastest=fastest, check_time=check_time)
    push = profile.acceleration_rad_s2 / profile.way_rad
    if isinstance(found, CutShort):
        return ended(robot, twist, profile, found, push)
    course = chosen().course(robot, found.cells, Track(twist, 1.0, found.q, found.dq))
    return TimedCourse(course, profile, (push, push))


def ended(robot: Robot, twist: Twist, profile: Profile, found: CutShort, push: float) -> PastLimit:
    """Joint limit that a line meets before its end, with the line to there, then straight in the joints.

    Raises:
        UnprovenError: it is something else that ends it.
    """
    if found.stuck == "singular":
        raise UnprovenError("singular" if reaches(robot, *twist.at(1.0)) else "unreachable")
    still = np.zeros(len(found.dq))
    on = straight_cells(found.q, found.dq, low=found.reached, stray=still, hurry=still)
    cells = Cells.joined([found.cells, replace(on, third=unbounded(on))])
    course = chosen().course(robot, cells, Track(twist, found.reached / GRID, found.q, found.dq))
    return PastLimit(TimedCourse(course, profile, (push, push), slower=False))


def unbounded(cells: Cells) -> Floats:
    """Vacuous bounds on the third derivative, for cells where the second jumps at their ends."""
    return np.full_like(cells.third, UNBOUNDED)

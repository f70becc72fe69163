"""Path with cut corners as courses: each leg whole, and each corner with all ways of cutting it ([PHY-58]).

A blend begins where the tool is so near to a waypoint, and ends where it is so far from it again. In between the joints
are somewhere in the triangle of where it begins, the waypoint and where it ends, at a mean of the speeds of both legs.
The triangle is covered by strips along either leg, each a straight course with as much to its sides; grown a little, as
speeds are, for a controller that cuts a corner otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from pep.pit.base.errors import MotionError, UnprovenError
from pep.pit.base.motion import STILL_RAD, BlendedPath, JointLeg, Profile
from pep.pit.path.course import Cells, straight_cells
from pep.pit.path.course_angles import Track
from pep.pit.path.straight_path import GRID
from pep.pit.robot.inverse_kinematics import stance
from pep.pit.robot.kinematics import link_frames
from pep.pit.robot.twist import turn_of, turned_by
from pep.pit.search.engine import chosen
from pep.pit.search.stream_course import AT_ONCE
from pep.pit.search.timed_course import Nowhere, PastLimit, TimedCourse, beyond, line_drive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pep.pit.base.motion import Floats, Joints, LineLeg
    from pep.pit.robot.robot import Robot
    from pep.pit.search.timed_course import Drive

LEG_CELLS: Final = 8  # of a straight leg, which bends nowhere
CORNER_CELLS: Final = 4  # likewise
BESIDE_RAD: Final = 0.2  # ours: of a joint, beside a course; where so much counts the tool is far off it
PLACES: Final = 256  # of a leg at which the tool's distance from its waypoint is looked at, with a bound in between
MOST_OF_LEG: Final = 0.5  # of a leg in one blend: two of them may meet, and never overlap
GROWN: Final = 0.1  # ours: of the longer part of a joint, to each side, for a controller that cuts otherwise
FASTER: Final = 1.25  # ours: times the speeds of both legs, likewise
STRIPS: Final = 2  # of a corner, for each of its speeds: more are tighter, and each costs a millisecond
TURNED: Final = 2.0  # ours: times what is met, since it is met at some places alone
TURNED_MOST: Final = 0.25  # ours: of the longest part of a joint: beyond it a mean of poses is faster than both legs
_SHARES: Final = np.array([(a / 4, b / 4) for a in range(5) for b in range(5 - a)])  # a grid of 15 places
"""Means of both parts at which a corner of the tool is looked at: its edges and inside."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A leg or corner, as one course may be made of it at any time.

    Attributes:
        start: joint angles at which it begins, rad.
        cells, track: of the course.
        profile: its timing, at plateau speed at a blended end.
        push: as in `TimedCourse`.
        tool_speed_m_s: likewise.
        least_s, joined, onward_rad_s: likewise.
    """

    start: Joints
    cells: Cells
    track: Track
    profile: Profile
    push: tuple[float, float]
    tool_speed_m_s: float
    least_s: float = 0.0
    joined: bool = False
    onward_rad_s: float = 0.0

    def near(self, q: Floats) -> bool:
        """True where an arm at `q` (6,) may be on it, as far as its pieces tell."""
        cells = self.cells
        half = 0.5 * ((cells.high - cells.low) / GRID)[:, None]
        return bool((np.abs(q - cells.q) <= cells.first * half + cells.stray + BESIDE_RAD).all(axis=1).any())

    def drive(self, robot: Robot) -> TimedCourse:
        """The course with its timing, of one thread."""
        course = chosen().course(robot, self.cells, self.track)
        return TimedCourse(
            course,
            self.profile,
            self.push,
            tool_speed_m_s=self.tool_speed_m_s,
            slower=False,
            least_s=self.least_s,
            joined=self.joined,
            onward_rad_s=self.onward_rad_s,
        )

    def leading_rad_s(self, robot: Robot) -> float:
        """Speed of a joint on it, at most."""
        return self.drive(robot).leading_rad_s(self.profile)


Planned: TypeAlias = Stretch | PastLimit | Nowhere


def blended_drives(
    robot: Robot, path: BlendedPath, *, at_rad: Joints | None = None, check_time: Callable[[], None]
) -> Iterator[tuple[Joints, Drive]]:
    """Start of each leg and corner, with it, in order; none after one that goes beyond a joint's limit.

    Args:
        robot: the arm.
        path: legs and blends.
        at_rad: where the arm is; what it cannot be on before the first that it may be on is left out.
        check_time: raises when the answer would come too late.

    Raises:
        MotionError: `OUT_OF_RANGE`, a blend takes more than half of a leg.
        UnprovenError: a line could not be traced, or a corner of the tool leaves what is reckoned with.
    """
    check_time()
    ahead, at = at_rad is None, np.array(at_rad)
    for start, planned in _planned(robot, path):
        check_time()
        ahead = ahead or not isinstance(planned, Stretch) or planned.near(at)
        if not ahead:
            continue
        yield start, planned.drive(robot) if isinstance(planned, Stretch) else planned


@lru_cache(maxsize=8)  # the paths under way: the watch asks about the same one ten times a second
def _planned(robot: Robot, path: BlendedPath) -> tuple[tuple[Joints, Planned], ...]:
    found: list[tuple[Joints, Planned]] = []
    start, before, blend_before = path.start, None, 0.0
    for leg in path.legs:
        planned = _leg(robot, start, leg, after_blend=blend_before > 0)
        if isinstance(planned, Stretch) and before is not None and blend_before > 0:
            into, out = (
                _part(robot, each, blend_before, arriving=arriving)
                for each, arriving in ((before, True), (planned, False))
            )
            found[-1] = found[-1][0], replace(before, least_s=before.least_s - into.seconds)
            planned = replace(planned, least_s=planned.least_s - out.seconds)
            found += _corner(robot, planned.start, into, out, turned=_turns(before) or _turns(planned))
        elif isinstance(planned, Nowhere) and blend_before + leg.blend_m > 0:
            raise MotionError("OUT_OF_RANGE", "a blend beside a leg without way")
        found.append((start, planned))
        if any(isinstance(each, PastLimit) for _, each in found):
            break
        if isinstance(planned, Stretch):
            start, before = _end(robot, planned, leg), planned
        blend_before = leg.blend_m
    # The arm may be under way to any of them when it is told to stop: it rests at no blend.
    fastest = max((each.leading_rad_s(robot) for _, each in found if isinstance(each, Stretch)), default=0.0)
    return tuple(
        (start, replace(each, onward_rad_s=fastest) if isinstance(each, Stretch) else each) for start, each in found
    )


def _end(robot: Robot, stretch: Stretch, leg: JointLeg | LineLeg) -> Joints:
    if isinstance(leg, JointLeg):
        return leg.target
    a, b, c, d, e, f = stretch.drive(robot).course.q(1.0).tolist()
    return a, b, c, d, e, f


def _leg(robot: Robot, start: Joints, leg: JointLeg | LineLeg, *, after_blend: bool) -> Planned:
    """A leg from end to end; at a blend it has its full speed at once, or still."""

    def ends(way: float, speed: float, acceleration: float) -> Profile:
        up, down = (AT_ONCE if blended else acceleration for blended in (after_blend, leg.blend_m > 0))
        return Profile(way, speed, up, down)

    if not isinstance(leg, JointLeg):
        drive = line_drive(
            robot,
            start,
            leg.target,
            speed_m_s=leg.speed_m_s,
            acceleration_m_s2=leg.acceleration_m_s2,
            check_time=_at_any_time,
        )
        if not isinstance(drive, TimedCourse):
            return drive
        profile = ends(drive.profile.way_rad, leg.speed_m_s, leg.acceleration_m_s2)
        course, least_s = drive.course, profile.way_rad / profile.peak_rad_s
        return Stretch(start, course.cells, course.track, profile, drive.push, drive.tool_speed_m_s, least_s)
    q, delta = np.array(start), np.array(leg.target) - np.array(start)
    if beyond(robot, q) or beyond(robot, q + delta):
        return PastLimit()
    way = float(np.abs(delta).max())
    if not way > STILL_RAD:
        return Nowhere()
    still: Floats = np.zeros(len(delta))
    push, profile = leg.acceleration_rad_s2 / way, ends(way, leg.speed_rad_s, leg.acceleration_rad_s2)
    return Stretch(
        start,
        straight_cells(q, delta, low=0, stray=still, hurry=still, count=LEG_CELLS),
        Track(None, 0.0, q, delta),
        profile,
        (push, push),
        0.0,
        way / profile.peak_rad_s,
    )


def _at_any_time() -> None:
    """The time is looked at between the answers: what is planned here is kept."""


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The part of a leg that a blend takes.

    Attributes:
        q: joint angles where the blend begins or ends, (6,), rad.
        share: of the leg.
        seconds: that it takes at the leg's speed.
        velocity: of the joints at the waypoint, at that speed, (6,), rad/s.
        velocities: the same at both ends of the part, (2, 6).
        push: of the leg, per its own share.
        tool_speed_m_s: that is commanded for the leg's tool point.
    """

    q: Floats
    share: float
    seconds: float
    velocity: Floats
    velocities: Floats
    push: float
    tool_speed_m_s: float


def _turns(stretch: Stretch) -> bool:
    return stretch.track.twist is not None


def _corner(
    robot: Robot, waypoint_rad: Joints, into: _Part, out: _Part, *, turned: bool
) -> Iterator[tuple[Joints, Planned]]:
    """All ways of cutting a corner, at the speed of either leg.

    What a body does at a mean of two joint speeds is never faster than at the faster of both: so all between is proven.
    """
    waypoint = np.array(waypoint_rad)
    u, w = waypoint - into.q, out.q - waypoint
    grown = GROWN * np.maximum(np.abs(u), np.abs(w))
    if turned:
        grown = grown + TURNED * _turned(robot, waypoint, u, w)
    bend = (out.velocity - into.velocity) / (into.seconds + out.seconds)
    tool = max(into.tool_speed_m_s, out.tool_speed_m_s)
    strips: list[tuple[Joints, Planned]] = []
    for strip in range(STRIPS):
        begins = waypoint - u * (1 - strip / STRIPS) + w * (strip + 0.5) / STRIPS
        strips.append(_strip(robot, begins, into, u, w, share=1 - strip / STRIPS, grown=grown, bend=bend, tool=tool))
    for strip in reversed(range(STRIPS)):
        begins = waypoint - u * (strip + 0.5) / STRIPS
        strips.append(_strip(robot, begins, out, w, u, share=1 - strip / STRIPS, grown=grown, bend=bend, tool=tool))
    least_s = _least_s(u + w, np.concatenate([into.velocities, out.velocities]), grown)
    for number, (start, one) in enumerate(strips):
        first, last = number == 0, number == len(strips) - 1
        timed = replace(one, least_s=first * least_s, joined=not last) if isinstance(one, Stretch) else one
        yield start, timed


def _least_s(chord: Floats, velocities: Floats, grown: Floats) -> float:
    """Least time for a corner: along its chord the arm is never faster than on the faster leg.

    Args:
        chord: from where the blend begins to where it ends, (6,), rad.
        velocities: of the joints on both legs, (n, 6), rad/s.
        grown: by how much the arm may be elsewhere at both ends, (6,), rad.
    """
    room = float(chord @ chord - 2 * grown @ np.abs(chord))
    fastest = FASTER * float((velocities @ chord).max())
    return max(0.0, room) / fastest if fastest > 0 else 0.0


def _strip(
    robot: Robot,
    begins: Floats,
    part: _Part,
    along: Floats,
    across: Floats,
    *,
    share: float,
    grown: Floats,
    bend: Floats,
    tool: float,
) -> tuple[Joints, Planned]:
    """Strip of a corner at the speed of a part.

    It is `share` of `along` long and a `STRIPS`-th of `across` wide.
    """
    a, b, c, d, e, f = begins.tolist()
    start = a, b, c, d, e, f
    way, seconds = share * along, share * part.seconds / FASTER
    stray = np.abs(across) / (2 * STRIPS) + grown
    if beyond(robot, begins, stray) or beyond(robot, begins + way, stray):
        return start, PastLimit()
    hurry = FASTER * seconds * np.abs(part.velocities - along / part.seconds).max(axis=0)
    cells = straight_cells(begins, way, low=0, stray=stray, hurry=hurry, count=CORNER_CELLS)
    change = np.broadcast_to(bend * seconds**2, cells.ddq.shape).copy()
    cells = replace(cells, ddq=change, second=np.abs(change))
    push = part.push / (part.share * share)
    profile = Profile(seconds, 1.0, AT_ONCE, AT_ONCE)
    return start, Stretch(start, cells, Track(None, 0.0, begins, way), profile, (push, push), tool)


def _part(robot: Robot, leg: Stretch, blend_m: float, *, arriving: bool) -> _Part:
    """The part of a leg nearest to its waypoint in which the tool may be within the blend of it.

    Raises:
        MotionError: `OUT_OF_RANGE`, it is more than half of the leg.
    """
    course, rate = leg.drive(robot).course, leg.profile.peak_rad_s / leg.profile.way_rad
    twist = leg.track.twist
    if twist is not None:
        length = float(np.linalg.norm(twist.line))
        share = blend_m / length if length > 0 else np.inf
    else:
        share = _share_within(robot, leg, blend_m, arriving=arriving)
    if not share <= MOST_OF_LEG:
        raise MotionError("OUT_OF_RANGE", "a blend takes more than half of a leg")
    (far, there), (_, here) = (course.at(s) for s in ((1.0 - share, 1.0) if arriving else (share, 0.0)))
    return _Part(
        far, share, share / rate, here * rate, np.stack([here, there]) * rate, max(leg.push), leg.tool_speed_m_s
    )


def _share_within(robot: Robot, leg: Stretch, blend_m: float, *, arriving: bool) -> float:
    """Share of a straight leg, from its waypoint, beyond which the tool is nowhere within the blend of that."""
    step = 1.0 / PLACES
    s = np.arange(PLACES + 1) * step
    q = leg.track.q + (1.0 - s if arriving else s)[:, None] * leg.track.dq
    rotation, origin = link_frames(robot, q)
    tool = origin[:, -1] + rotation[:, -1] @ np.array(robot.tool.tcp_m)
    away = np.linalg.norm(tool - tool[0], axis=1)
    fastest = float(robot.reach[robot.body_index("tcp")] @ np.abs(leg.track.dq))
    within = np.flatnonzero(away - 0.5 * step * fastest <= blend_m)
    return (int(within[-1]) + 0.5) * step


def _turned(robot: Robot, waypoint: Floats, u: Floats, w: Floats) -> Floats:
    """Greatest distance of means of two tool poses from the means of their joint angles, (6,), rad.

    Raises:
        UnprovenError: it is more than a quarter as far as the corner is wide.
    """
    here = stance(robot, waypoint)
    means = waypoint + _SHARES @ np.stack([-u, w])
    rotation, origin = link_frames(robot, np.concatenate([means, [waypoint - u, waypoint + w]]))
    position, turn = origin[:, -1] + rotation[:, -1] @ np.array(robot.tool.tcp_m), rotation[:, -1]
    moves = _SHARES @ (position[-2:] - here.position)
    turns = _SHARES @ turn_of(turn[-2:] @ here.rotation.T)
    wanted = np.stack([turned_by(each) for each in turns]) @ here.rotation
    off = np.concatenate(
        [here.position + moves - position[:-2], turn_of(wanted @ turn[:-2].transpose(0, 2, 1))], axis=1
    )
    try:
        most = np.abs(np.linalg.solve(here.jacobian, off.T)).max(axis=1)
    except np.linalg.LinAlgError:
        raise UnprovenError("singular") from None
    if not float(most.max()) <= TURNED_MOST * max(float(np.abs(u).max()), float(np.abs(w).max())):
        raise UnprovenError("corner")
    return np.asarray(most)

"""Timed trajectory as pieces, each straight in the joints, with all that the arm may do beside it.

On a piece the joints go on evenly from its beginning to its end; by how much the curve of the trajectory differs from
that, in place and in speed, is bounded exactly. Added to it are the tube in which the controller's servo follows, and
the stop that may begin anywhere on the piece: the joints' own, straight along their tangent (PHY-65). So the pieces are
courses of the form that a servo target has, and cover the arm at every time and after every stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import MotionError
from pep.pit.base.motion import Profile
from pep.pit.path.course import straight_cells
from pep.pit.path.course_angles import Track
from pep.pit.path.timed_curve import TimedCurve, curve_of
from pep.pit.search.engine import chosen
from pep.pit.search.stream_course import AT_ONCE, ENVELOPE_CELLS
from pep.pit.search.timed_course import PastLimit, TimedCourse, beyond

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.base.motion import Floats, Joints, JointTrajectory
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.timed_course import Drive

PIECES_MOST: Final = 48  # PHY-65: an answer, also the watch's, takes a millisecond or two for each
LAG_S: Final = 0.06  # PHY-65: twice the servo's least lookahead (U12): how far back its targets count
HOLD_RAD: Final = 2e-3  # PHY-65: as an approval binds a start; rounding of the wire and the arm's own hold
HOLD_RAD_S: Final = 1e-3  # PHY-65: the bound of standstill
RIPPLE: Final = 1.1  # PHY-65: factor of all joints' speeds by which targets in steps of 4 ms make them uneven
FINEST_RAD_S: Final = 0.03  # PHY-65: difference of speed that a piece may span at first; raised until pieces suffice
COARSER: Final = 1.25  # factor by which it is raised each time
FINEST_S: Final = 0.05  # PHY-65: as much of that speed is the difference in place


@dataclass(frozen=True, slots=True, eq=False)
class TimedPiece:
    """A piece of a trajectory, from one time to another.

    Attributes:
        since_s, until_s: those times.
        start: joint angles there, (6,), rad.
        speed: even joint speeds to its end, (6,), rad/s.
        tube: distance of the arm from the even way, at most, without a stop's, (6,), rad.
        hurry: difference of its joint speeds from the even ones, at most, but for the ripple, (6,), rad/s.
        acceleration: of each joint, the greatest either way, (6,), rad/s2.
    """

    since_s: float
    until_s: float
    start: Floats
    speed: Floats
    tube: Floats
    hurry: Floats
    acceleration: Floats

    @property
    def fastest_rad_s(self) -> float:
        """Greatest speed of any joint, but for the ripple."""
        return float((np.abs(self.speed) + self.hurry).max())


@dataclass(frozen=True, slots=True)
class TimedPieces:
    """All pieces of a trajectory, which tile its time in order."""

    pieces: tuple[TimedPiece, ...]

    @property
    def ends_s(self) -> tuple[float, ...]:
        """Times of the ends."""
        return tuple(piece.until_s for piece in self.pieces)


def refuse_unfollowable(robot: Robot, motion: JointTrajectory) -> None:
    """Checks that the robot's joints reach every point, and get from each to the next in time.

    Raises:
        MotionError: `ROBOT_LIMIT`, naming the point, the joint and what would do.
    """
    low, high = robot.position_ranges_rad
    names = [joint.name for joint in robot.model.joints]
    for number, point in enumerate(motion.points):
        for name, angle, least, most in zip(names, point, low.tolist(), high.tolist(), strict=True):
            if not least <= angle <= most:
                raise MotionError(
                    "ROBOT_LIMIT",
                    f"point {number}: {name} at {angle:.4f} rad, outside of {least:.4f} to {most:.4f} rad",
                )
    rows = list(zip(motion.times_s, motion.points, strict=True))
    for number, ((t, before), (u, after)) in enumerate(pairwise(rows), 1):
        for name, a, b, limit in zip(names, before, after, robot.speed_limits_rad_s.tolist(), strict=True):
            if not abs(b - a) <= limit * (u - t):
                raise MotionError(
                    "ROBOT_LIMIT",
                    f"point {number}: {name} jumps by {abs(b - a):.4f} rad in {u - t:.4f} s, faster than {limit:.3f} "
                    f"rad/s; give it {abs(b - a) / limit:.3f} s or more",
                )


@lru_cache(maxsize=8)  # the watch asks about the one under way again and again
def pieces_of(motion: JointTrajectory) -> TimedPieces:
    """Pieces of the trajectory, as few as the finest bounds allow, at most `PIECES_MOST`."""
    curve = curve_of(motion)
    # A piece spans at most twice its step of each joint's speed: a smaller one cannot suffice.
    changes = float((np.abs(curve.a) * np.diff(curve.t)[:, None]).sum(axis=0).max())
    step = max(FINEST_RAD_S, changes / (2 * PIECES_MOST))
    while True:
        ends = _ends(curve, step)
        if len(ends) <= PIECES_MOST:
            return TimedPieces(tuple(piece_between(curve, t, u) for t, u in pairwise([0.0, *ends])))
        step *= COARSER


def piece_between(curve: TimedCurve, since_s: float, until_s: float) -> TimedPiece:
    """The piece between two times."""
    t, q, v, a = _nodes(curve, since_s, until_s)
    step = np.diff(t)[:, None]
    speed = (q[-1] - q[0]) / (until_s - since_s)
    sag = (np.abs(a) * step**2 / 8).max(axis=0)  # a parabola over its chord
    beside = np.abs(q - q[0] - (t - since_s)[:, None] * speed).max(axis=0) + sag
    uneven = np.abs(v - speed).max(axis=0)
    around = (curve.t[1:] > since_s - LAG_S) & (curve.t[:-1] < until_s + LAG_S)
    hardest = np.abs(curve.a[around]).max(axis=0)
    return TimedPiece(
        since_s,
        until_s,
        q[0],
        speed,
        tube=beside + 0.5 * hardest * LAG_S**2 + HOLD_RAD,
        hurry=uneven + 0.5 * hardest * LAG_S + HOLD_RAD_S,
        acceleration=hardest,
    )


def _nodes(curve: TimedCurve, since_s: float, until_s: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Times, angles and speeds at both ends and at the nodes between them, and the accelerations in between."""
    first = int(np.searchsorted(curve.t, since_s, side="right"))
    last = int(np.searchsorted(curve.t, until_s, side="left"))
    (q0, v0), (q1, v1) = curve.at(since_s), curve.at(until_s)
    return (
        np.concatenate([[since_s], curve.t[first:last], [until_s]]),
        np.concatenate([[q0], curve.q[first:last], [q1]]),
        np.concatenate([[v0], curve.v[first:last], [v1]]),
        curve.a[first - 1 : last],
    )


def _ends(curve: TimedCurve, step_rad_s: float) -> list[float]:
    """Ends of pieces each of which spans no more than so much of speed, and of place as `FINEST_S` says.

    Where one acceleration alone spans more, its time is cut evenly.
    """
    widths = np.diff(curve.t)
    parts = np.maximum(1, np.ceil(np.abs(curve.a).max(axis=1) * widths / (2 * step_rad_s))).astype(int)
    times = np.concatenate(
        [t + width * np.arange(1, count + 1) / count for t, width, count in zip(curve.t, widths, parts, strict=False)]
    )
    times = np.concatenate([[0.0], times[:-1], [curve.duration_s]])
    ends: list[float] = []
    since, last = 0, len(times) - 1
    while since < last:
        # Twice as far as long as that is even enough, and then halves: any end that is even enough will do.
        good, reach = since + 1, 2
        while since + reach <= last and _even_enough(curve, times[since], times[since + reach], step_rad_s):
            good, reach = since + reach, 2 * reach
        bad = min(since + reach, last + 1)
        while bad - good > 1:
            middle = (good + bad) // 2
            if _even_enough(curve, times[since], times[middle], step_rad_s):
                good = middle
            else:
                bad = middle
        ends.append(float(times[good]))
        since = good
    return ends


def _even_enough(curve: TimedCurve, since_s: float, until_s: float, step_rad_s: float) -> bool:
    t, q, v, _ = _nodes(curve, float(since_s), float(until_s))
    speed = (q[-1] - q[0]) / (until_s - since_s)
    beside = np.abs(q - q[0] - (t - since_s)[:, None] * speed).max()
    return bool(np.abs(v - speed).max() <= step_rad_s and beside <= step_rad_s * FINEST_S)


def piece_drive(robot: Robot, piece: TimedPiece, cell: CellParameters) -> Drive:
    """Course of all that the arm may do on this piece, and after a stop that begins there."""
    fastest = piece.fastest_rad_s
    braking = cell.stop_deceleration_rad_s2 / fastest
    stop_s = RIPPLE**2 / (2 * braking)
    seconds = piece.until_s - piece.since_s + stop_s
    way, stray = seconds * piece.speed, piece.tube + stop_s * piece.hurry
    if beyond(robot, piece.start, stray) or beyond(robot, piece.start + way, stray):
        return PastLimit()
    cells = straight_cells(piece.start, way, low=0, stray=stray, hurry=seconds * piece.hurry, count=ENVELOPE_CELLS)
    cells.ddq[:] = seconds**2 * piece.acceleration
    profile = Profile(seconds, RIPPLE, AT_ONCE, braking)
    course = chosen().course(robot, cells, Track(None, 0.0, piece.start, way))
    return TimedCourse(course, profile, (braking / seconds, braking / seconds), slower=False)


def piece_drives(robot: Robot, motion: JointTrajectory, cell: CellParameters) -> Iterator[tuple[Joints, Drive]]:
    """Start of each piece, with its course; none after one that may meet a joint's limit.

    Raises:
        MotionError: as `refuse_unfollowable`.
    """
    refuse_unfollowable(robot, motion)
    for piece in pieces_of(motion).pieces:
        a, b, c, d, e, f = piece.start.tolist()
        drive = piece_drive(robot, piece, cell)
        yield (a, b, c, d, e, f), drive
        if isinstance(drive, PastLimit):
            return

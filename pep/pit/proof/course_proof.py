"""Course of a curved motion as a proof records it: pieces, bounds, and nodes for its rows (PHY-44 to 48).

The bounds are the trace's own, spelt a little larger, so that rounding on the other side does not refuse them; rows are
then found on the course with the bounds as they are spelt.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.pit.base.errors import ProofError
from pep.pit.base.motion import SpeedL
from pep.pit.path.line_trace import FINEST, CutShort
from pep.pit.path.straight_path import GRID
from pep.pit.proof.motion_proof import hex_of, hexed
from pep.pit.robot.inverse_kinematics import stance
from pep.pit.robot.twist import turn_of
from pep.pit.search.engine import chosen
from pep.pit.search.kernel.compiled_course import CompiledCourse
from pep.pit.search.stream_course import AT_ONCE

if TYPE_CHECKING:
    from pep.pit.base.motion import Driven, Floats, Joints, JointTrajectory, LineLeg
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.twist import Twist
    from pep.pit.search.timed_course import TimedCourse

NOT_TRACED: Final[dict[str, Any]] = {
    "limit": False, "edges": [], "second": [], "third": [], "nodes": [], "until": 0, "ahead": None, "seconds": None,
}  # fmt: skip
"""Record of a motion that needs no course."""
SLACK: Final = 5e-7  # of an index: half of the checker's own slack (PHY-32), for bounds that are spelt larger
SPELT: Final = 2.0**-30  # relative: far above rounding, far below any visible change of an index
SHORT_M: Final = 1e-14  # rounding of a tool's place, against the way of a short line
SHORTER: Final = 16  # times as much of it is in a third derivative
BITS_OF_SECOND: Final = 32  # of a bound of a second derivative
BITS_OF_THIRD: Final = 20  # of a third, which counts a thousand times less
STRAYS: Final = 2.0**-20  # share by which what depends on spelt bounds is taken to be larger


class Recorded(CompiledCourse):
    """A drive's course with the bounds as a proof spells them, and the record of it.

    Attributes:
        until: as far as it is a line of the tool, in 1 / GRID.
    """

    def __init__(self, robot: Robot, start: Joints, drive: TimedCourse) -> None:
        """Spells the bounds of every piece of the line."""
        self.drive, self.start = drive, np.array(start)
        self.until = 0 if drive.twist is None else round(drive.line_until * GRID)
        cells = drive.course.cells
        line = cells.high <= self.until
        short = 0.0 if drive.twist is None else SHORT_M / drive.twist.way_m
        share = SPELT + short
        second = np.where(line[:, None], _spelt(_larger(cells.second, share), BITS_OF_SECOND), cells.second)
        third = np.where(line[:, None], _spelt(_larger(cells.third, SHORTER * short), BITS_OF_THIRD), cells.third)
        half = (0.5 * (cells.high - cells.low) / GRID)[:, None]
        first = np.where(line[:, None], np.abs(cells.dq) + half * second, cells.first)
        stray, hurry = (np.where(each > 0, _larger(each, STRAYS), each) for each in (cells.stray, cells.hurry))
        spelt = replace(cells, first=first, second=second, third=third, stray=stray, hurry=hurry)
        super().__init__(robot, spelt, drive.course.track)

    def at(self, s: float) -> tuple[Floats, Floats]:
        """Angles as of `Course.at`, to rounding; exact where a leg begins and ends."""
        q, dq = self.drive.course.at(s)
        twist = self.drive.twist
        if twist is None or not s * GRID <= self.until:
            return q, dq
        if s == 0:
            q = self.start
        here = stance(self.robot, q)
        if 0 < s < 1:
            position, rotation = twist.at(s)
            missing = np.concatenate([position - here.position, turn_of(rotation @ here.rotation.T)])
            here = stance(self.robot, q + np.linalg.solve(here.jacobian, missing))
        return here.q, np.asarray(np.linalg.solve(here.jacobian, twist.rate))

    def record(self, places: set[int], seconds: float | None) -> dict[str, Any]:
        """The record, with a node for each piece's ends and middle and for each of these places on the line.

        Args:
            places: in 1 / GRID.
            seconds: of a held speed's whole course, at full speed.
        """
        cells, until = self.cells, self.until
        line = cells.high <= until
        low, high = cells.low[line], cells.high[line]
        keys = {*low.tolist(), *high.tolist(), *((low + high) // 2).tolist(), *(k for k in places if k <= until)}
        return NOT_TRACED | {
            "edges": [*low.tolist(), until] if len(low) else [],
            "second": [hexed(row) for row in cells.second[line]],
            "third": [hexed(row) for row in cells.third[line]],
            "nodes": [[key, hexed(self.q(key / GRID))] for key in sorted(keys)],
            "until": until,
            "seconds": None if seconds is None else hex_of(seconds),
        }


def _larger(bounds: Floats, share: float) -> Floats:
    """Each bound of a row, larger by this share of itself and of the largest."""
    return np.asarray(bounds + share * (bounds + bounds.max(axis=1, keepdims=True)))


def _spelt(bounds: Floats, bits: int) -> Floats:
    """Bounds, rounded up to so many bits."""
    fraction, exponent = np.frexp(bounds)
    return np.asarray(np.ldexp(np.ceil(np.ldexp(fraction, bits)), exponent - bits))


def followed(way: Recorded, places: set[int], motion: Driven | LineLeg | JointTrajectory) -> dict[str, Any]:
    """The record of a course.

    Args:
        way: the course.
        places: that its rows need, in 1 / GRID.
        motion: what was asked.
    """
    drive = way.drive
    if drive.twist is None:
        return NOT_TRACED
    return way.record(places, drive.profile.way_rad if isinstance(motion, SpeedL) else None)


def past_limit(
    robot: Robot, start: Joints, shown: TimedCourse | None, motion: Driven | LineLeg | JointTrajectory
) -> dict[str, Any]:
    """Record of a motion beyond a joint's limit, with the piece of its line that shows it.

    Raises:
        ProofError: no piece shows it.
    """
    if shown is None:
        return NOT_TRACED | {"limit": True}
    way = Recorded(robot, start, shown)
    record = followed(way, set(), motion) | {"limit": True}
    if isinstance(motion, SpeedL) and shown.profile.braking_rad_s2 < AT_ONCE:
        return record  # it is the stop that goes there
    assert shown.twist is not None
    return record | {"ahead": _piece_at_limit(robot, shown.twist, shown.course.q(way.until / GRID), way.until)}


def _piece_at_limit(robot: Robot, twist: Twist, q: Floats, since: int) -> int:
    """End of the piece of a line that begins at `since`, with these joint angles, and meets a joint's limit."""
    for width in (
        FINEST,
        FINEST // 2,
    ):  # pieces of a line that is not as long as its course are shorter than the finest
        until = min(since + width, GRID)
        found = chosen().trace(
            robot,
            twist,
            q,
            since=since,
            until=until,
            pieces=1,
            fastest=np.full(len(q), np.inf),
            check_time=lambda: None,
        )
        if isinstance(found, CutShort) and found.stuck == "joint_limit":
            return until
    raise ProofError("PHYSICS_FAULT", "no piece shows the joint limit")

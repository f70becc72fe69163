"""Course of a curved motion as a proof records it: pieces, bounds, and nodes for its rows (PHY-44 to 48).

The bounds are the trace's own, spelt a little larger, so that rounding on the other side does not refuse them; rows are
then found on the course with the bounds as they are spelt.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np

from pep.pit.base.errors import ProofError
from pep.pit.base.motion import LineLeg, MoveL, Profile, ServoJ, SpeedL
from pep.pit.path.line_trace import ASKED_POSES, FINEST, FIRST_PIECES
from pep.pit.path.straight_path import GRID
from pep.pit.proof.motion_proof import hex_of, hexed
from pep.pit.robot.inverse_kinematics import reaching, stance
from pep.pit.robot.twist import Twist, tool_pose, turn_of
from pep.pit.search.engine import chosen
from pep.pit.search.kernel.compiled_course import CompiledCourse
from pep.pit.search.stream_course import AT_ONCE
from pep.pit.search.timed_course import beyond, fastest_of

if TYPE_CHECKING:
    from pep.pit.base.motion import Driven, Floats, Joints
    from pep.pit.path.line_trace import LineTrace
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.timed_course import Nowhere, TimedCourse

NOT_TRACED: Final[dict[str, Any]] = {
    "doubt": None, "edges": [], "second": [], "third": [], "nodes": [], "until": 0, "ahead": None, "angles": [],
    "seconds": None,
}  # fmt: skip
"""Record of a motion that needs no course."""
SLACK: Final = 5e-7  # of an index: half of the checker's own slack (PHY-32), for bounds that are spelt larger
SPELT: Final = 2.0**-30  # relative: far above rounding, far below any visible change of an index
SHORT_M: Final = 1e-14  # rounding of a tool's place, against the way of a short line
SHORTER: Final = 16  # times as much of it is in a third derivative
BITS_OF_SECOND: Final = 32  # of a bound of a second derivative
BITS_OF_THIRD: Final = 20  # of a third, which counts a thousand times less
HALVINGS: Final = (GRID // FIRST_PIECES // FINEST).bit_length() - 1  # from the first pieces to the finest
STRAYS: Final = 2.0**-20  # share added to numbers that depend on spelt bounds


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

    def record(self, places: set[int], seconds: float | None, *, told: str | None) -> dict[str, Any]:
        """The record, with nodes for each piece's ends and middle and for each of these places on the line.

        Args:
            places: in 1 / GRID.
            seconds: of a held speed's whole course, at full speed.
            told: its doubt.
        """
        cells, until = self.cells, self.until
        line = cells.high <= until
        low, high = cells.low[line], cells.high[line]
        keys = {*low.tolist(), *high.tolist(), *((low + high) // 2).tolist(), *(k for k in places if k <= until)}
        return NOT_TRACED | {
            "doubt": told,
            "edges": [*low.tolist(), until],
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


def followed(way: Recorded, places: set[int], motion: Driven | LineLeg) -> dict[str, Any]:
    """Record of a course, with the reason of its end where it is not followed to its end.

    Args:
        way: the course.
        places: that its rows need, in 1 / GRID.
        motion: the assessed motion.

    Raises:
        ProofError: no piece shows why it breaks off.
    """
    drive = way.drive
    if drive.twist is None:
        return NOT_TRACED
    held = isinstance(motion, SpeedL)
    record = way.record(places, drive.profile.way_rad if held else None, told=drive.doubt)
    if drive.doubt is None or (held and drive.profile.braking_rad_s2 < AT_ONCE):
        return record
    at = drive.course.q(way.until / GRID)
    return _broken_off(way.robot, drive.twist, at, record, start=way.start, profile=drive.profile)


def untraced(
    robot: Robot, cell: CellParameters, start: Joints, drive: Nowhere, motion: Driven | LineLeg
) -> dict[str, Any]:
    """Record of a motion without trace, with the first piece where that one is the reason.

    Raises:
        ProofError: that piece does not show it.
    """
    at = np.array(start)
    told = NOT_TRACED | {"doubt": drive.doubt}
    if drive.doubt in (None, "half_turn") or isinstance(motion, ServoJ) or beyond(robot, at):
        return told
    match motion:
        case SpeedL(_, velocity, acceleration, duration):
            up = acceleration / max(map(abs, velocity))
            held = duration + cell.stop_delay_s
            ramp = min(1 / up, held)
            seconds = up * ramp * (held - 0.5 * ramp)
            full = seconds * np.array(velocity)
            twist = Twist(*tool_pose(robot, at), full[:3], full[3:])
            told |= {"seconds": hex_of(seconds)}
            profile = Profile(seconds, 1.0, up, AT_ONCE)
        case MoveL() | LineLeg():
            twist = Twist.between(robot, start, motion.target)
            profile = Profile(twist.way_m, motion.speed_m_s, motion.acceleration_m_s2)
        case _:
            assert_never(motion)
    return _broken_off(robot, twist, at, told, start=at, profile=profile)


def _broken_off(
    robot: Robot, twist: Twist, q: Floats, record: dict[str, Any], *, start: Floats, profile: Profile
) -> dict[str, Any]:
    """The record of a line that breaks off at `q`, with the piece that cannot be followed.

    Where that is no violation, with joint angles for the poses of the rest.
    """
    until: int = record["until"]
    if record["doubt"] == "singular":
        record = record | {"angles": angles_for(robot, twist, until)}
    rate = profile.peak_rad_s / profile.way_rad
    for halvings in reversed(range(HALVINGS + 1)):
        width = (GRID // FIRST_PIECES) >> halvings
        if until + width > GRID:
            break
        found = chosen().trace(
            robot,
            twist,
            q,
            since=until,
            until=until + width,
            pieces=1,
            fastest=np.full(len(q), np.inf),
            check_time=lambda: None,
        )
        if width > FINEST and (found.stuck is not None or len(found.cells) > 1):
            continue  # not proven whole
        if found.stuck is not None and width == FINEST:
            return record | {"ahead": {"until": until + width, "fast": False}}
        if found.stuck is None and (np.abs(found.cells.dq[0]) > fastest_of(robot, rate)).any():
            return _with_fast(record, until, found, start)
    raise ProofError("PHYSICS_FAULT", "no piece shows why the line breaks off")


def _with_fast(record: dict[str, Any], until: int, found: LineTrace, start: Floats) -> dict[str, Any]:
    """The record with the piece on which a joint is too fast to prove anything of use."""
    cell = found.cells
    second = _spelt(_larger(cell.second, SPELT), BITS_OF_SECOND)
    nodes = dict(record["nodes"]) or {0: hexed(start)}
    nodes |= {int(cell.mid[0]): hexed(cell.q[0]), found.reached: hexed(found.q)}
    return record | {
        "edges": [*(record["edges"] or [until]), found.reached],
        "second": [*record["second"], hexed(second[0])],
        "third": [*record["third"], hexed(_spelt(cell.third, BITS_OF_THIRD)[0])],
        "nodes": [[key, q] for key, q in sorted(nodes.items())],
        "ahead": {"until": found.reached, "fast": True},
    }


def angles_for(robot: Robot, twist: Twist, since: int) -> list[list[str]]:
    """Joint angles for the poses of the rest of a line, in any configuration.

    Raises:
        ProofError: none were found for one of them: it is out of reach.
    """
    poses = [twist.at(float(share)) for share in np.linspace(since / GRID, 1, ASKED_POSES)]
    found = reaching(robot, np.array([p for p, _ in poses]), np.array([r for _, r in poses]))
    if np.isnan(found).any():
        raise ProofError("PHYSICS_FAULT", "a pose of the line is out of reach")
    return [hexed(q) for q in found]

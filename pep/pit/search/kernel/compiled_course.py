"""Compiled engine for curved motions as the rest of the room calls it: trace, course, searches."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base import pair_columns
from pep.pit.base.errors import MotionError, WorkLimitError
from pep.pit.base.motion import Profile
from pep.pit.base.tier import MOVING
from pep.pit.path.course import Cells, Course
from pep.pit.path.course_angles import Track
from pep.pit.path.line_trace import FIRST_PIECES, CutShort, LineTrace, Stuck
from pep.pit.path.straight_path import GRID
from pep.pit.robot.robot import Robot
from pep.pit.robot.twist import Twist, tool_pose
from pep.pit.scene.cell import CellParameters
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import BLOW_DEPTH, BLOW_RESOLUTION, Certified, Fit, Witness, cut
from pep.pit.search.kernel import course_rows, course_search
from pep.pit.search.kernel.arithmetic import bending, course_poses, line_pieces
from pep.pit.search.kernel.arithmetic.joint_torques import masses_of, torques
from pep.pit.search.kernel.arithmetic.row_table import BOUND, Rows
from pep.pit.search.kernel.arithmetic.tool_pose import KernelTwist, Wrist
from pep.pit.search.kernel.compiled_path import (
    NO_FIELD,
    NO_NUMBERS,
    arm_of,
    law_of,
    leaves_of,
    packed,
    table_of,
    timing_of,
    unknown_rows,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Keys, Leaves
    from pep.pit.scene.pairs import Pairs
    from pep.pit.search.kernel.arithmetic.pair_rows import Field

    Check = Callable[[], None]

_STUCK: Final[dict[int, Stuck]] = {line_pieces.SINGULAR: "singular", line_pieces.JOINT_LIMIT: "joint_limit"}
_NOWHERE: Final = -1.0  # where a line ends that is none: no place is before it
_POINTS: Final = KernelTwist(np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def _tool_of(robot: Robot) -> line_pieces.TracedArm:
    wrist = Wrist(np.array(robot.rotations), np.array(robot.offsets), np.array(robot.tool.tcp_m, dtype=float))
    lowest, highest = robot.position_ranges_rad
    return line_pieces.TracedArm(wrist, robot.reach[robot.body_index("tcp")].copy(), lowest.copy(), highest.copy())


def _line_of(twist: Twist) -> KernelTwist:
    return KernelTwist(*(np.ascontiguousarray(part, dtype=float) for part in _parts(twist)))


def _parts(twist: Twist) -> tuple[Floats, Floats, Floats, Floats]:
    return twist.position, twist.rotation, twist.line, twist.turn


def trace(
    robot: Robot,
    twist: Twist,
    start: Floats,
    *,
    since: int = 0,
    until: int = GRID,
    pieces: int = FIRST_PIECES,
    fastest: Floats,
    check_time: Check,
) -> LineTrace | CutShort:
    """Provable part of the joints' path under `twist` between `since` and `until`, in 1 / GRID.

    Args:
        robot: the arm.
        twist: the line of its tool.
        start: joint angles at `since`, (6,).
        since: beginning of the part in question.
        until: its end; `pieces` times a power of two divides it.
        pieces: of the first cut; more of them are each bounded more tightly.
        fastest: a rate of the joints, (6,), rad per unit of s, beyond which nothing more is to be proven.
        check_time: raises when the answer would come too late.
    """
    check_time()
    begin = np.array(start, dtype=float)
    found = line_pieces.traced(_tool_of(robot), _line_of(twist), begin, since, until, pieces, np.array(fastest, float))
    check_time()
    q, dq, ddq, first, second, third, stray = found.rows.transpose(1, 0, 2)
    cells = Cells(found.low, found.high, q, dq, ddq, first, second, third, stray, np.zeros_like(stray))
    if found.stuck == line_pieces.PROVEN:
        return LineTrace(cells, found.q, found.dq)
    return CutShort(cells, found.reached, found.q, found.dq, _STUCK[found.stuck])


class CompiledCourse(Course):
    """Course with the kernel as its engine. Same promises as `Course`; not shared between threads."""

    def __init__(self, robot: Robot, cells: Cells, track: Track) -> None:
        """A course that holds no configuration yet."""
        super().__init__(robot, cells, track)
        arm, wrist = arm_of(robot), _tool_of(robot).wrist
        held = np.stack(
            [cells.q, cells.dq, cells.ddq, cells.first, cells.second, cells.third, cells.stray, cells.hurry], axis=1
        )
        twist, until = track.twist, track.until
        line, until = (_POINTS, _NOWHERE) if twist is None else (_line_of(twist), until)
        along = course_poses.KernelTrack(line, until, np.array(track.q), np.array(track.dq))
        low, high = np.ascontiguousarray(cells.low), np.ascontiguousarray(cells.high)
        self._curve = course_poses.Curve(arm, wrist, low, high, held, bending.bends_of(arm, held), along)
        self._held = course_poses.nothing_known(len(robot.bodies))
        self._packed: tuple[Pairs, Field] | None = None

    def packed(self, pairs: Pairs) -> Field:
        """The pairs as the kernel's arrays."""
        if self._packed is None or self._packed[0] is not pairs:
            self._packed = pairs, packed(pairs)
        return self._packed[1]

    def _keep(self, held: course_poses.CurveConfigurations) -> None:
        """Keeps the configurations known by now.

        Raises:
            MotionError: `PHYSICS_FAULT`, a proven line was not found again.
        """
        self._held = held
        if held.counts[course_poses.LOST]:
            raise MotionError("PHYSICS_FAULT", "a proven line was not found again")

    def at(self, s: float) -> tuple[Floats, Floats]:
        """As `Course.at`."""
        q, dq = np.empty(len(self.delta)), np.empty(len(self.delta))
        course_poses.placed(self._held, self._curve, s, q, dq)
        self._keep(self._held)
        return q, dq

    def _answered(
        self, what: int, field: Field, rows: Rows, timing: Floats = NO_NUMBERS, law: Floats = NO_NUMBERS, *more: float
    ) -> tuple[Rows, float]:
        """Answer of the kernel, which may have got to know configurations."""
        numbers = np.array(more, dtype=float)
        held, found, number = course_rows.answered(what, self._held, self._curve, field, rows, timing, law, numbers)
        self._keep(held)
        return found, number

    @property
    def known(self) -> tuple[Keys, Floats]:
        """As `Course.known`."""
        count = int(self._held.counts[course_poses.USED])
        return self._held.keys[:count].copy(), self._held.q[:count].copy()

    def rush(self, low: Keys, high: Keys) -> Floats:
        """As `Route.rush`."""
        found, _ = self._answered(course_rows.RUSHES, NO_FIELD, unknown_rows(low, high, np.zeros_like(low)))
        return np.asarray(found.numbers)

    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """As `Route.examine`."""
        found, _ = self._answered(course_rows.EXAMINED, self.packed(pairs), unknown_rows(low, high, pair))
        return leaves_of(found)

    def rush_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """As `Route.rush_at`."""
        return self._at(pairs, key, pair)[1]

    def clearance_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """As `Route.clearance_at`."""
        return self._at(pairs, key, pair)[0]

    def _at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> tuple[Floats, Floats]:
        rows = unknown_rows(pair, pair, pair)
        found, _ = self._answered(course_rows.MET_AT, self.packed(pairs), rows, NO_NUMBERS, NO_NUMBERS, key)
        return found.numbers[:, 0], found.numbers[:, 1]

    def certify(
        self,
        pairs: Pairs,
        profile: Profile,
        stop: Stopping,
        *,
        rows: NDArray[np.intp],
        floor: float,
        check_time: Check,
    ) -> Certified:
        """The proven index of these pairs on this course, as `CompiledPath.certify` has it of a path."""
        check_time()
        groups, first = int(pairs.group.max(initial=-1)) + 1, len(cut(self)[0])
        field, law = self.packed(pairs), np.array(law_of(pairs, stop))
        held, found = course_search.certify(
            self._held, self._curve, field, rows, groups, np.array(timing_of(profile)), law, floor, first
        )
        self._keep(held)
        check_time()
        if found.status == course_search.TOO_MANY:
            raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
        return Certified(
            upper=found.upper,
            attained=found.attained,
            witnesses=tuple(sorted(_witnesses(found.witnesses), key=lambda w: (-w.index, w.clearance_m, w.key))),
            violated={pairs.kind_of(w.pair): w for w in _witnesses(found.violated)},
            leaves=leaves_of(found.leaves),
            leaf_index=found.leaves.numbers[:, BOUND].copy(),
        )

    def fits(
        self, pairs: Pairs, profile: Profile, stop: Stopping, leaves: Leaves, *, index: float, check_time: Check
    ) -> Fit:
        """As `CompiledPath.fits`."""
        check_time()
        timing, law = np.array(timing_of(profile)), np.array(law_of(pairs, stop))
        kept, proven = self._answered(course_rows.FITS, self.packed(pairs), table_of(leaves), timing, law, index)
        return Fit(leaves_of(kept), bool(proven))

    def blow_ratio(self, pairs: Pairs, profile: Profile, stop: Stopping, *, check_time: Check) -> float:
        """As `CompiledPath.blow_ratio`."""
        check_time()
        people = np.flatnonzero(pairs.kind == pair_columns.PERSON)
        if not people.size:
            return 0.0
        timing, law = np.array(timing_of(profile)), np.array(law_of(pairs, stop))
        rows, more = unknown_rows(people, people, people), (len(cut(self)[0]), BLOW_DEPTH, BLOW_RESOLUTION)
        return self._answered(course_rows.BLOW, self.packed(pairs), rows, timing, law, *more)[1]


def _witnesses(found: course_search.CurveMet) -> list[Witness]:
    met = zip(*(column.tolist() for column in found), strict=True)
    return [Witness(key, pair, index, gap, speed) for index, gap, speed, key, pair in met if pair >= 0]


def compile_all() -> None:
    """Compiles every entry for curved motions, or reads it from disk."""
    robot, cell = Robot.load("ur3e"), CellParameters()
    start = np.array((0.0, -1.5, 1.5, -1.5, -1.5, 0.0))
    position, rotation = tool_pose(robot, start)
    twist = Twist(position, rotation, np.array([0.0, 0.0, -0.02]), np.zeros(3))
    found = trace(robot, twist, start, fastest=np.full(len(start), math.inf), check_time=_no_limit)
    assert isinstance(found, LineTrace)
    course = CompiledCourse(robot, found.cells, Track(twist, 1.0, found.q, found.dq))
    profile = Profile(twist.way_m, 0.1, 1.0)
    stop = stopping(cell, perception_age_s=0.0, joint_speed_rad_s=1.0)
    pairs = pairs_of(robot, cell.surveyed, cell, grown_m=0.0)
    rows = np.arange(len(pairs))
    certified = course.certify(pairs, profile, stop, rows=rows, floor=MOVING, check_time=_no_limit)
    course.fits(pairs, profile, stop, certified.leaves, index=MOVING, check_time=_no_limit)
    course.blow_ratio(replace(pairs, kind=np.zeros_like(pairs.kind)), profile, stop, check_time=_no_limit)
    course.examine(pairs, np.zeros(1, np.int64), np.full(1, GRID), rows[:1])
    course.rush(np.zeros(1, np.int64), np.full(1, GRID))
    course.clearance_at(pairs, 0, rows[:1])
    course.at(0.5)
    torques(masses_of(robot.pinocchio), *map(np.ascontiguousarray, (found.cells.q, found.cells.dq, found.cells.ddq)))


def _no_limit() -> None:
    """Ends at no time: the time is not counted."""

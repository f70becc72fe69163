"""Rest of a motion that is no single straight run: of a drive, and of a path's legs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.assessment.assessment import milli
from pep.pit.assessment.dispatch import drive_of, joint_moves, line_drives
from pep.pit.assessment.straight_remaining import JOINT_LIMIT, MOVES, OFF_PATH, Remaining, RemainingRun, strays_m
from pep.pit.base.motion import STILL_RAD, BlendedPath, JointPath, JointTrajectory, LinePath, MoveL, Run, ServoJ, SpeedL
from pep.pit.base.tier import HIGHEST, MOVING
from pep.pit.path.straight_path import GRID
from pep.pit.search.blended_course import blended_drives
from pep.pit.search.course_limits import Effort
from pep.pit.search.question import as_run
from pep.pit.search.timed_course import Nowhere, PastLimit, TimedCourse
from pep.pit.search.trajectory_pieces import piece_drives

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from pep.pit.base.motion import Driven, Floats, Joints, Paths, Profile
    from pep.pit.path.course import Course
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene
    from pep.pit.search.timed_course import Drive

HORIZON_S: Final = 1.0
"""Ours (PHY-59): horizon of a look at a path.

A look, its answer and a stop together take less.
"""
PLACE_STEPS: Final = 8  # of a projection onto a course: it closes in quadratically
NEAR_PLACE: Final = 1e-9  # of a course: a step as short as that changes nothing


class RemainingCourse(RemainingRun):
    """Rest of a drive, from the arm's place."""

    def __init__(
        self,
        robot: Robot,
        start: Joints,
        drive: Drive,
        cell: CellParameters,
        *,
        at_rad: Joints,
        authorised_milli: int,
        check_time: Callable[[], None],
    ) -> None:
        still = Run(start, start, 0.0, math.inf, math.inf)
        super().__init__(robot, still, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time)
        self.drive = drive

    def prepare(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining | None:
        """The steps of a straight run that do not depend on the speed, on the drive's course."""
        drive, cell, at = self.drive, self.cell, np.array(self.at_rad)
        if isinstance(drive, PastLimit):
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=JOINT_LIMIT)
        if isinstance(drive, Nowhere):
            if not strays_m(self.robot, at - np.array(self.run.start)) <= cell.tracking_tolerance_m:
                return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
            return Remaining(holds=True, index_milli=0, cause="")
        # 1. Where on the course the arm is, or beside it by no more than the course says.
        self.course = course = drive.course
        s = _place(course, at)
        beside = np.maximum(np.abs(at - course.q(s)) - course.cells.stray[course.cells.holding(s * GRID)], 0)
        if not strays_m(self.robot, beside) <= cell.tracking_tolerance_m:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
        self.profile, self.since = drive.profile, int(s * GRID)
        self.effort = Effort(self.robot, drive, cell)
        # 2. The view, without what the arm holds.
        self.look_around(scene, age_s, touch, self.effort.surface_speed_m_s(drive.profile))
        return None

    def _ask(self, profile: Profile, fraction: float, until: int) -> Remaining:
        """The steps of a straight run that depend on the speed."""
        assert isinstance(self.drive, TimedCourse)
        ratios = ((ratio.index, ratio.name) for ratio in self.effort.ratios(profile, stretched=fraction))
        return self.judge(
            self.course,
            profile,
            floors=[(MOVING, MOVES), *ratios],
            speeds=self.effort.surface_speed_m_s(profile),
            joint_speed_rad_s=self.drive.leading_rad_s(profile),
            limits=None,
            until=until,
        )

    def strays_m(self, middle: int, until: int) -> Floats:
        """Strays as on a straight path, with the joints' ways from the middle as the course bounds them."""
        del middle
        cells = self.course.cells
        met = np.clip(np.minimum(cells.high, until) - np.maximum(cells.low, self.since), 0, None) / GRID
        way = (cells.first * met[:, None]).sum(axis=0) + cells.stray.max(axis=0)
        return np.asarray(self.robot.reach @ way)


def _place(course: Course, at: Floats) -> float:
    """Place of the arm at `at` (6,) on the course: the nearest of the cells' middles, then along the course."""
    cells = course.cells
    nearest = int(np.square(cells.q - at).sum(axis=1).argmin())
    s = float(cells.mid[nearest]) / GRID
    for _ in range(PLACE_STEPS):
        q, dq = course.at(s)
        length2 = float(dq @ dq)
        if not length2 > STILL_RAD**2:
            break
        s, before = min(max(s + float((at - q) @ dq) / length2, 0.0), 1.0), s
        if abs(s - before) <= NEAR_PLACE:
            break
    return s


class RemainingLegs:
    """Rest of a path: of the first leg that the arm can be on, and all of every later one."""

    def __init__(
        self, legs: Iterable[RemainingRun], check_time: Callable[[], None], *, horizon_s: float = math.inf
    ) -> None:
        """Takes the legs in order; each is looked at only when it has to be, and none beyond the horizon.

        Args:
            legs: of the path, or what may be left of them.
            check_time: raises when the answer would come too late.
            horizon_s: what the arm cannot reach in that time is not looked at now (PHY-59).
        """
        self._horizon_s = horizon_s
        self._legs = iter(legs)
        self.check_time = check_time  # of every leg that is asked
        self._known: list[tuple[RemainingRun, Remaining | None]] = []

    def prepare(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining | None:
        """Prepares the leg that the arm is on; those behind it are prepared when they are asked about."""
        self._view = scene, age_s, touch
        for leg in self._legs:
            early = leg.prepare(*self._view)
            if early is None or early.cause != OFF_PATH:
                self._known.append((leg, early))
                return None
        return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)

    def at(self, fraction: float) -> Remaining:
        """The first answer that does not hold, or the highest of those that do."""
        left_s, first = self._horizon_s, True

        def ask(leg: RemainingRun) -> tuple[Remaining, bool]:
            nonlocal left_s, first
            drive = leg.drive if isinstance(leg, RemainingCourse) else None
            joined = False
            if isinstance(drive, TimedCourse):
                joined = drive.joined
                if not first:
                    left_s -= drive.least_s
            first = False
            return leg.at(fraction), joined or left_s > 0

        return self._worst(ask)

    def near(self, fraction: float, seconds: float) -> Remaining:
        """First answer that does not hold, or the highest, of the legs in reach.

        Each leg could take up all of the time.
        """
        return self._worst(lambda leg: (leg.near(fraction, seconds), leg.until(fraction, seconds) >= GRID))

    def _worst(self, ask: Callable[[RemainingRun], tuple[Remaining, bool]]) -> Remaining:
        """Worst of the answers of `ask` for each leg, as long as it also says that the next one counts."""
        found: list[Remaining] = []
        for leg, early in self._reached():
            leg.check_time = self.check_time
            answer, on = (early, True) if early is not None else ask(leg)
            found.append(answer)
            if not answer.holds:
                return answer
            if not on:
                break
        return max(found, key=lambda answer: answer.index_milli)

    def _reached(self) -> Iterator[tuple[RemainingRun, Remaining | None]]:
        """The leg that the arm is on and those behind it, prepared."""
        yield from self._known
        for leg in self._legs:
            leg.at_rad = leg.run.start  # the arm is not on it yet
            self._known.append((leg, leg.prepare(*self._view)))
            yield self._known[-1]


def rests_of(
    robot: Robot,
    motion: Driven | Paths | JointTrajectory,
    cell: CellParameters,
    *,
    at_rad: Joints,
    authorised_milli: int,
    age_s: float,
    check_time: Callable[[], None],
) -> RemainingCourse | RemainingLegs:
    """Rest of a motion that is no single straight run; see `remaining`."""

    def of_drive(start: Joints, drive: Drive) -> RemainingCourse:
        return RemainingCourse(
            robot, start, drive, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time
        )

    def of_run(run: Run) -> RemainingRun:
        return RemainingRun(robot, run, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time)

    match motion:
        case MoveL() | SpeedL() | ServoJ():
            return of_drive(motion.start, drive_of(robot, motion, cell, perception_age_s=age_s, check_time=check_time))
        case BlendedPath():
            drives = blended_drives(robot, motion, at_rad=at_rad, check_time=check_time)
            return RemainingLegs((of_drive(start, drive) for start, drive in drives), check_time, horizon_s=HORIZON_S)
        case JointPath():
            return RemainingLegs((of_run(as_run(move, cell)) for move in joint_moves(motion)), check_time)
        case LinePath() | JointTrajectory():
            if isinstance(motion, LinePath):
                drives = line_drives(robot, motion, check_time=check_time)
            else:
                drives = piece_drives(robot, motion, cell)
            return RemainingLegs((of_drive(start, drive) for start, drive in drives), check_time)
        case _:
            assert_never(motion)

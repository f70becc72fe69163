"""What is left of a motion that is no single straight run: of a drive, and of a path's legs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.assessment import milli
from pep.pit.clearance import ROUNDING_M
from pep.pit.departure import RETREAT, departure, slow_enough
from pep.pit.drive import Drive, Nowhere
from pep.pit.driven import DOUBTFUL, JOINT_LIMIT
from pep.pit.driving import drive_of, joint_moves, line_drives
from pep.pit.effort import Effort
from pep.pit.motion import STILL_RAD, JointPath, LinePath, MoveL, Run, ServoJ, SpeedL
from pep.pit.pairs import pairs_of
from pep.pit.path import GRID
from pep.pit.question import as_run, view_around
from pep.pit.remaining import MOVES, OFF_PATH, PERCEPTION, RETREATS, Remaining, Rest, against, strays_m
from pep.pit.separation import stopping
from pep.pit.tier import HIGHEST, MOVING
from pep.pit.touching import gentle_rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from pep.pit.cell import CellParameters
    from pep.pit.course import Course
    from pep.pit.motion import Driven, Floats, Joints, Paths
    from pep.pit.pairs import Pairs
    from pep.pit.robot import Robot
    from pep.pit.route import Route
    from pep.pit.scene import Scene
    from pep.pit.separation import Stopping

PLACE_STEPS: Final = 8  # of a projection onto a course: it closes in quadratically


class DriveRest(Rest):
    """What is left of a drive, from where the arm is."""

    def __init__(
        self,
        robot: Robot,
        start: Joints,
        drive: Drive | Nowhere,
        cell: CellParameters,
        *,
        at_rad: Joints,
        authorised_milli: int,
        check_time: Callable[[], None],
    ) -> None:
        still = Run(start, start, 0.0, math.inf, math.inf)
        super().__init__(robot, still, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time)
        self.drive = drive

    def answer(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining:
        """The steps of a straight run, on the drive's course."""
        drive, cell, at = self.drive, self.cell, np.array(self.at_rad)
        if isinstance(drive, Nowhere) or drive.doubt == JOINT_LIMIT:
            off = at - np.array(self.run.start)
            if drive.doubt is None and not strays_m(self.robot, off) <= cell.tracking_tolerance_m:
                return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
            worst = {None: 0.0, JOINT_LIMIT: HIGHEST}.get(drive.doubt, DOUBTFUL)
            return against(self.authorised_milli, milli(worst), drive.doubt or "")
        # 1. Where on the course the arm is, or beside it by no more than the course says.
        course, profile = drive.course, drive.profile
        s = _place(course, at)
        beside = np.maximum(np.abs(at - course.q(s)) - course.cells.stray[course.cells.holding(s * GRID)], 0)
        if not strays_m(self.robot, beside) <= cell.tracking_tolerance_m:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
        since = int(s * GRID)
        # 2. What the motion asks of the arm does not depend on the view.
        effort = Effort(self.robot, drive, cell)
        floors = [(MOVING, MOVES), *((ratio.index, ratio.name) for ratio in effort.ratios(profile))]
        if drive.doubt is not None:
            floors.append((DOUBTFUL, drive.doubt))
        speeds = effort.surface_speed_m_s(profile)
        joint = float(drive.joint_speeds_rad_s(profile).max())
        # 3. The view, without what the arm holds.
        lag_m = float(speeds.max()) * (age_s or 0.0)
        view = view_around(self.robot, scene, age_s, self.at_rad, cell, lag_m=lag_m)
        floors.append((view.floor, PERCEPTION))
        bare = pairs_of(self.robot, view.scene, cell, grown_m=view.grown_m, touch=touch)
        pairs = bare.meant(gentle_rows(course, bare, profile, cell, since=since, check_time=self.check_time))
        # 4. What is violated where the arm is, and whether the rest only leads away from it.
        surface = float(speeds[: self.robot.world_bodies].max())
        slow = slow_enough(cell, joint_speed_rad_s=joint, speed_m_s=surface)
        here = departure(course, pairs, cell, slow=slow, since=since)
        if here.retreating.size:
            floors.append((RETREAT, RETREATS))
        floor, cause = max(floors)
        if not milli(floor) <= self.authorised_milli:
            return Remaining(holds=False, index_milli=milli(floor), cause=cause)
        # 5. The proof that no pair exceeds what is authorised.
        stop = stopping(cell, perception_age_s=view.stopping_age_s, joint_speed_rad_s=joint)
        return self._proof(course, pairs, profile, stop, rows=here.rows, speeds=speeds, since=since, floor=floor)

    def _far_enough(
        self, path: Route, pairs: Pairs, stop: Stopping, *, rows: NDArray[np.intp], speeds: Floats, since: int
    ) -> tuple[NDArray[np.intp], float]:
        """As on a straight path, with the joints' ways before and behind the middle as the course bounds them."""
        middle = (since + GRID) // 2
        assert not isinstance(self.drive, Nowhere)
        cells = self.drive.course.cells
        met = np.clip(np.minimum(cells.high, GRID) - np.maximum(cells.low, since), 0, None) / GRID
        way = (cells.first * met[:, None]).sum(axis=0) + cells.stray.max(axis=0)
        strays = path.robot.reach @ way
        body = pairs.body[rows]
        clearance = path.clearance_at(pairs, middle, rows) - strays[body] - ROUNDING_M
        bound = pairs.index(rows, clearance, speeds[body], stop)
        settled = (bound <= self.limit) & ~(clearance < pairs.violated_below[rows])
        return rows[~settled], float(bound[settled].max(initial=0))


def _place(course: Course, at: Floats) -> float:
    """Where on the course the arm at `at` (6,) is: the nearest of the cells' middles, and from there along."""
    cells = course.cells
    nearest = int(np.square(cells.q - at).sum(axis=1).argmin())
    s = float(cells.mid[nearest]) / GRID
    for _ in range(PLACE_STEPS):
        q, dq = course.at(s)
        length2 = float(dq @ dq)
        if not length2 > STILL_RAD**2:
            break
        s = min(max(s + float((at - q) @ dq) / length2, 0.0), 1.0)
    return s


class LegsRest:
    """What is left of a path: of the first leg that the arm can be on, and all of every later one."""

    def __init__(self, legs: Iterable[Rest]) -> None:
        """The legs in order; each is looked at only when it has to be."""
        self._legs = legs

    def answer(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining:
        """The first answer that does not hold, or the highest of those that do."""
        found: list[Remaining] = []
        for leg in self._legs:
            if found:  # the arm is not on it yet
                leg.at_rad = leg.run.start
            answer = leg.answer(scene, age_s, touch)
            if answer.cause == OFF_PATH and not found:
                continue
            found.append(answer)
            if not answer.holds:
                return answer
        if not found:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
        return max(found, key=lambda answer: answer.index_milli)


def rests_of(
    robot: Robot,
    motion: Driven | Paths,
    cell: CellParameters,
    *,
    at_rad: Joints,
    authorised_milli: int,
    age_s: float,
    check_time: Callable[[], None],
) -> DriveRest | LegsRest:
    """What is left of a motion that is no single straight run; see `remaining`."""

    def of_drive(start: Joints, drive: Drive | Nowhere) -> DriveRest:
        return DriveRest(
            robot, start, drive, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time
        )

    def of_run(run: Run) -> Rest:
        return Rest(robot, run, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time)

    match motion:
        case MoveL() | SpeedL() | ServoJ():
            return of_drive(motion.start, drive_of(robot, motion, cell, perception_age_s=age_s, check_time=check_time))
        case JointPath():
            return LegsRest(of_run(as_run(move, cell)) for move in joint_moves(motion))
        case LinePath():
            drives = line_drives(robot, motion, check_time=check_time)
            return LegsRest(of_drive(start, drive) for start, drive in drives)
        case _:
            assert_never(motion)

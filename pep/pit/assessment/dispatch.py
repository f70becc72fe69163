"""Dispatch of each motion that is no single straight run: to a drive, or to the legs of a path."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from pep.pit.assessment.course_assessment import DriveQuestion
from pep.pit.assessment.path_legs import AssessedLeg, as_one
from pep.pit.assessment.straight_assessment import MoveQuestion
from pep.pit.base.motion import (
    BlendedPath,
    JointPath,
    JointTrajectory,
    LinePath,
    MoveJ,
    MoveL,
    ServoJ,
    SpeedL,
    profile_of,
)
from pep.pit.scene.separation import stopping
from pep.pit.search.blended_course import blended_drives
from pep.pit.search.question import as_run
from pep.pit.search.stream_course import servo_drive, speed_drive
from pep.pit.search.timed_course import PastLimit, TimedCourse, line_drive
from pep.pit.search.trajectory_pieces import piece_drives
from policies.evidence.evidence import ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.motion import Driven, Joints, Paths
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.view import View
    from pep.pit.search.timed_course import Drive


def drive_of(
    robot: Robot, motion: Driven, cell: CellParameters, *, perception_age_s: float, check_time: Callable[[], None]
) -> Drive:
    """The motion as a course with its timing.

    Raises:
        MotionError: `FRAMES_MISMATCH` or `ROBOT_LIMIT`, as `line_drive` and `servo_drive` say.
        UnprovenError: as `line_drive` and `speed_drive` say.
    """
    match motion:
        case MoveL():
            return line_drive(
                robot,
                motion.start,
                motion.target,
                speed_m_s=motion.speed_m_s,
                acceleration_m_s2=motion.acceleration_m_s2,
                stated=motion.stated_start,
                check_time=check_time,
            )
        case SpeedL():
            return speed_drive(robot, motion, cell, check_time=check_time)
        case ServoJ():
            stop = stopping(cell, perception_age_s=perception_age_s, joint_speed_rad_s=0.0)
            return servo_drive(robot, motion, cell, reaction_s=stop.reaction_s)
        case _:
            assert_never(motion)


class PathQuestion:
    """All legs of a path in one view of the world."""

    def __init__(
        self,
        robot: Robot,
        view: View,
        cell: CellParameters,
        *,
        touch: frozenset[str],
        seed: bytes,
        check_time: Callable[[], None],
    ) -> None:
        """Makes a question of which nothing is computed yet."""
        self.robot, self.view, self.cell, self.touch = robot, view, cell, touch
        self.seed, self.check_time = seed, check_time

    def answer(self, motion: Paths | JointTrajectory) -> Assessment | ImpactFault:
        """Answer for the whole path, up to the first leg that goes beyond a joint's limit."""
        match motion:
            case JointTrajectory():
                drives = list(piece_drives(self.robot, motion, self.cell))
                return as_one(motion.start, len(drives), self._driven(drives))
            case BlendedPath():
                return self._blended(motion)
            case JointPath():
                legs = self._joint_legs(motion)
            case LinePath():
                legs = self._driven(line_drives(self.robot, motion, check_time=self.check_time))
            case _:
                assert_never(motion)
        return as_one(motion.start, len(motion.legs), legs)

    def _blended(self, path: BlendedPath) -> Assessment | ImpactFault:
        drives = list(blended_drives(self.robot, path, check_time=self.check_time))
        return as_one(path.start, len(drives), self._driven(drives))

    def _seed(self, number: int) -> bytes:
        return self.seed + number.to_bytes(4, "big")  # 4 bytes: more legs than any path may have

    def _joint_legs(self, path: JointPath) -> Iterator[AssessedLeg | ImpactFault]:
        for number, move in enumerate(joint_moves(path)):
            run = as_run(move, self.cell)
            question = MoveQuestion(
                self.robot,
                self.view,
                run,
                self.cell,
                touch=self.touch,
                seed=self._seed(number),
                check_time=self.check_time,
            )
            answer, profile = question.answer(), profile_of(run)
            yield (
                answer
                if isinstance(answer, ImpactFault)
                else AssessedLeg(answer, profile.duration_s if profile else 0.0)
            )

    def _driven(self, drives: Iterable[tuple[Joints, Drive]]) -> Iterator[AssessedLeg | ImpactFault]:
        for number, (start, drive) in enumerate(drives):
            answer = DriveQuestion(
                self.robot,
                self.view,
                start,
                drive,
                self.cell,
                touch=self.touch,
                seed=self._seed(number),
                check_time=self.check_time,
            ).answer()
            duration = drive.profile.duration_s if isinstance(drive, TimedCourse) else 0.0
            yield answer if isinstance(answer, ImpactFault) else AssessedLeg(answer, duration)


def joint_moves(path: JointPath) -> Iterator[MoveJ]:
    """The legs as joint moves, each from where the one before ends."""
    start = path.start
    for leg in path.legs:
        yield MoveJ(start, leg.target, leg.speed_rad_s, leg.acceleration_rad_s2)
        start = leg.target


def line_drives(robot: Robot, path: LinePath, *, check_time: Callable[[], None]) -> Iterator[tuple[Joints, Drive]]:
    """Start of each leg, with the leg; none after one that goes beyond a joint's limit.

    Raises:
        UnprovenError: as `line_drive` says.
    """
    start = path.start
    for leg in path.legs:
        drive = line_drive(
            robot,
            start,
            leg.target,
            speed_m_s=leg.speed_m_s,
            acceleration_m_s2=leg.acceleration_m_s2,
            check_time=check_time,
        )
        yield start, drive
        if isinstance(drive, PastLimit):
            return
        if isinstance(drive, TimedCourse):
            a, b, c, d, e, f = drive.course.q(1.0).tolist()
            start = a, b, c, d, e, f

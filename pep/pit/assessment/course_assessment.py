"""Answer for a motion that is no straight run: the steps of a straight one, on its course."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from pep.pit.assessment.assessment import Assessment, RowsCertificate
from pep.pit.assessment.straight_assessment import MoveQuestion
from pep.pit.base.motion import Run
from pep.pit.base.tier import HIGHEST, MOVING, tier_of
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import refuse_hidden
from pep.pit.search.course_limits import Effort
from pep.pit.search.speed_bisection import highest_speed
from pep.pit.search.start_violations import RETREAT, departure, slow_enough
from pep.pit.search.timed_course import Nowhere, PastLimit, TimedCourse
from pep.pit.second.course_check import drive_check
from pep.pit.second.straight_check import Disagreement
from policies.evidence.evidence import ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Joints
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Keys, Leaves
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.view import View
    from pep.pit.search.arm_limits import Ratio
    from pep.pit.search.certify import Certified
    from pep.pit.search.timed_course import Drive

SLOWEST_SHARE: Final = 0.02  # of the commanded speed; slower than this is of no use, so no lower tier is named


@dataclass(frozen=True, eq=False)
class CourseCertificate(RowsCertificate):
    """Proof of a course, with its nodes: a check of it needs no inverse kinematics.

    Attributes:
        key: places of the nodes, in 1 / GRID, (n,).
        q: the joint angles there, (n, 6), rad.
    """

    key: Keys
    q: Floats


class DriveQuestion(MoveQuestion):
    """One drive in one view of the world, and the steps to its answer."""

    def __init__(
        self,
        robot: Robot,
        view: View,
        start: Joints,
        drive: Drive,
        cell: CellParameters,
        *,
        touch: frozenset[str],
        seed: bytes,
        check_time: Callable[[], None],
    ) -> None:
        """Makes a question of which nothing is computed yet."""
        still = Run(start, start, 0.0, math.inf, math.inf)
        super().__init__(robot, view, still, cell, touch=touch, seed=seed, check_time=check_time)
        self.drive = drive

    def answer(self) -> Assessment | ImpactFault:
        """The answer; what goes nowhere, or beyond a joint's limit, needs no search."""
        match self.drive:
            case Nowhere():
                return self._standing()
            case PastLimit():
                return self._past_limit("")
            case TimedCourse() as drive:
                return self._searched(drive)
            case _:
                assert_never(self.drive)

    def _searched(self, drive: TimedCourse) -> Assessment | ImpactFault:
        """The steps, in order."""
        # 1. What the motion asks of the arm.
        course, profile = drive.course, drive.profile
        effort = Effort(self.robot, drive, self.cell)
        ratios, speeds = effort.ratios(profile), effort.surface_speed_m_s(profile)
        speed = float(speeds[: self.robot.world_bodies].max())
        joint_speed = drive.leading_rad_s(profile)
        stop = self._stopping(joint_speed)
        bare = pairs_of(self.robot, self.view.scene, self.cell, grown_m=self.view.grown_m, touch=self.touch)
        pairs = self._with_meant(course, bare, profile)
        # 2. What is violated where the arm stands, and whether this is a retreat from it.
        slow = slow_enough(self.cell, joint_speed_rad_s=joint_speed, speed_m_s=speed)
        start = departure(course, pairs, self.cell, slow=slow)
        retreats = start.retreating.size > 0
        # 3. The proven index of all the rest.
        floor = max(MOVING, self.view.floor, RETREAT if retreats else 0.0, *(r.index for r in ratios))
        certified = course.certify(pairs, profile, stop, rows=start.rows, floor=floor, check_time=self.check_time)
        refuse_hidden(pairs, certified)
        violations = {str(kind) for kind in certified.violated}
        # 4. The second engine has to agree.
        self.check_time()
        checked = drive_check(drive, pairs, self.view.scene, stop, certified=certified, rows=start.rows, seed=self.seed)
        if isinstance(checked, Disagreement):
            return ImpactFault("ENGINES_DISAGREE", checked.what)
        # 5. The answer, and the speed at which it would be a tier lower.
        index = min(certified.upper, HIGHEST)
        causes = self._causes(profile, pairs, certified, ratios=ratios, speed_m_s=speed, retreating=start.retreating)
        lower = None
        if drive.slower and not (violations or retreats):
            lower = self._slower(drive, effort, bare, certified, ratios=ratios, target=float(tier_of(index) - 1))
        decided = certified.witnesses[0] if certified.witnesses and certified.attained > floor else None
        return self._assessment(
            index,
            causes,
            tuple(sorted(violations)),
            clearance_m=math.inf if decided is None else decided.clearance_m,
            speed_m_s=speed,
            tcp_speed_m_s=float(speeds[self.robot.body_index("tcp")]),
            lower=lower,
            contact_ratio=course.blow_ratio(pairs, profile, stop, check_time=self.check_time),
            certificate=_certificate(drive, certified, start.rows),
        )

    def _stopping(self, joint_speed_rad_s: float) -> Stopping:
        return stopping(self.cell, perception_age_s=self.view.stopping_age_s, joint_speed_rad_s=joint_speed_rad_s)

    def _slower(
        self,
        drive: TimedCourse,
        effort: Effort,
        bare: Pairs,
        certified: Certified,
        *,
        ratios: tuple[Ratio, ...],
        target: float,
    ) -> float | None:
        """The highest commanded speed, to a step of the bisection, whose index is proven to be at most `target`."""
        if target < MOVING or self.view.floor > target:
            return None
        course = drive.course
        # What counts no more at this speed counts no more at a lower one (faster never lowers).
        asks = max(ratio.index for ratio in ratios) > target
        leaves = certified.leaves.take(certified.leaf_index > target)

        def falls(speed: float) -> bool:
            nonlocal leaves
            profile = drive.at_speed(speed)
            if asks and max(r.index for r in effort.ratios(profile)) > target:
                return False
            meant = self._with_meant(course, bare, profile)
            stop = self._stopping(drive.leading_rad_s(profile))
            fit = course.fits(meant, profile, stop, leaves, index=target, check_time=self.check_time)
            leaves = fit.leaves
            return fit.proven

        fastest = drive.profile.speed_rad_s
        return highest_speed(falls, slowest=SLOWEST_SHARE * fastest, fastest=fastest)


def _certificate(drive: TimedCourse, certified: Certified, asked: NDArray[np.intp]) -> CourseCertificate:
    leaves: Leaves = certified.leaves
    key, q = drive.course.known
    pair: NDArray[np.intp] = leaves.pair
    return CourseCertificate(asked, pair, leaves.low, leaves.high, certified.leaf_index, key, q)

"""Assessment of a command before it is sent: its possible impact on people, things and the robot.

`assess` never raises. A question without an answer, or with an unbelievable input, gives an `ImpactFault`; a fault is
no tier, and no approval overrides it.
"""

from __future__ import annotations

import math
import time
import traceback
from typing import TYPE_CHECKING, assert_never

from pep.pit.assessment.assessment import ENGINE, LISTED, MILLI, Assessment, Evident, micro, milli, seen
from pep.pit.assessment.course_assessment import DriveQuestion
from pep.pit.assessment.dispatch import PathQuestion, drive_of
from pep.pit.assessment.grip_assessment import gripping
from pep.pit.assessment.output_index import output_cause
from pep.pit.assessment.readiness import compile_all
from pep.pit.assessment.straight_assessment import MoveQuestion
from pep.pit.base.errors import PitError
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointPath,
    JointTrajectory,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
)
from pep.pit.base.tier import MOVING, tier_of
from pep.pit.scene.view import view_of
from pep.pit.search.question import as_run, deadline, refuse_nonsense, view_around
from pep.pit.second.straight_check import Disagreement
from policies.evidence.evidence import Contribution, ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Motion
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene
    from pep.pit.scene.view import View


def assess(
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    *,
    perception_age_s: float | None,
    touch: frozenset[str],
    seed: bytes,
    clock: Callable[[], float] = time.monotonic,
) -> Assessment | ImpactFault:
    """Impact that `motion` could have in `scene`. Never raises.

    Args:
        robot: the arm with its tool, which must be the one that the cell names, and with what that holds.
        scene: the newest valid view, or None when there is none.
        motion: motion to be assessed.
        cell: the cell's parameters.
        perception_age_s: age of the view, or None when there is none.
        touch: names of objects that the token grants to touch; with the cell's contacts they make a touch a meant one.
        seed: digest of the command; picks the configurations at which the second engine is asked.
        clock: monotonic seconds; the answer comes within `cell.time_limit_s` or is a fault.
    """
    try:
        return _assess(robot, scene, motion, cell, age_s=perception_age_s, touch=touch, seed=seed, clock=clock)
    except PitError as error:
        return ImpactFault(error.reason, error.detail)
    except Exception as error:  # noqa: BLE001 - any failure in here must end in a denial, not in the caller
        frames = traceback.extract_tb(error.__traceback__)
        return ImpactFault("PHYSICS_FAULT", f"{type(error).__name__} in {frames[-1].name}")


def _assess(
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    *,
    age_s: float | None,
    touch: frozenset[str],
    seed: bytes,
    clock: Callable[[], float],
) -> Assessment | ImpactFault:
    compile_all()  # compiled, where it is the first call of all, before the time is counted
    check_time = deadline(clock, cell.time_limit_s)
    refuse_nonsense(robot, motion, cell, touch)
    match motion:
        case MoveJ() | SpeedJ():
            view = view_around(robot, scene, age_s, motion.start, cell)
            run = as_run(motion, cell)
            return MoveQuestion(robot, view, run, cell, touch=touch, seed=seed, check_time=check_time).answer()
        case MoveL() | SpeedL() | ServoJ():
            view = view_around(robot, scene, age_s, motion.start, cell)
            drive = drive_of(robot, motion, cell, perception_age_s=view.stopping_age_s, check_time=check_time)
            return DriveQuestion(
                robot, view, motion.start, drive, cell, touch=touch, seed=seed, check_time=check_time
            ).answer()
        case JointPath() | LinePath() | JointTrajectory() | BlendedPath():
            view = view_around(robot, scene, age_s, motion.start, cell)
            return PathQuestion(robot, view, cell, touch=touch, seed=seed, check_time=check_time).answer(motion)
        case GripperMove():
            # The fingers close on, or let go of, the held object: it stays in the view.
            return _grip_answer(robot, view_of(scene, age_s, cell), motion, cell)
        case OutputSet():
            return _output_answer(robot, view_of(scene, age_s, cell), motion, cell)
        case _:
            assert_never(motion)


def _grip_answer(robot: Robot, view: View, motion: GripperMove, cell: CellParameters) -> Assessment | ImpactFault:
    grip = gripping(robot, view, motion, cell)
    if isinstance(grip, Disagreement):
        return ImpactFault("ENGINES_DISAGREE", grip.what)
    causes = grip.causes
    finger_speed = micro(motion.speed_m_s)
    told = [
        Contribution(c.kind, milli(c.index), "gripper", c.object, 0, micro(c.clearance_m), finger_speed, c.source)
        for c in causes
        if c.index > MOVING or c is causes[0]
    ]
    told = sorted([*seen(view), *told], key=lambda c: -c.index_milli)
    index = max(view.floor, causes[0].index)
    return Assessment(
        tier=tier_of(index),
        index=index,
        clearance_m=causes[0].clearance_m,
        speed_m_s=motion.speed_m_s,
        contributions=tuple(told[:LISTED]),
        violations=(),
        lower_tier_speed=None,
        tcp_speed_m_s=0.0,
        contact_ratio=grip.contact_ratio,
        start=motion.q,
        certificate=Evident("gripper"),
        perception=view.perception,
        perception_age_s=view.age_s,
        engine=ENGINE,
        model_digest=robot.model_digest,
        scene_digest=view.scene.digest,
    )


def _output_answer(robot: Robot, view: View, motion: OutputSet, cell: CellParameters) -> Assessment:
    told = output_cause(motion, cell)
    index = told.index_milli / MILLI
    return Assessment(
        tier=tier_of(index),
        index=index,
        clearance_m=math.inf,
        speed_m_s=0.0,
        contributions=(told,) if index > 0 else (),
        violations=(),
        lower_tier_speed=None,
        tcp_speed_m_s=0.0,
        contact_ratio=0.0,
        start=(),
        certificate=Evident("output"),
        perception=view.perception,
        perception_age_s=view.age_s,
        engine=ENGINE,
        model_digest=robot.model_digest,
        scene_digest=view.scene.digest,
    )

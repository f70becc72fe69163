"""The one question of this room: what could this command do to people, things and the robot, before it is sent?

`assess` never raises. What cannot be answered, or must not be believed, is an `ImpactFault`; a fault is no tier, and no
approval overrides it.
"""

from __future__ import annotations

import math
import time
import traceback
from typing import TYPE_CHECKING, Final, assert_never

from pep.pit.assessment import EMPTY_CERTIFICATE, ENGINE, LISTED, Assessment, micro, milli, seen
from pep.pit.contact import contact_ratio
from pep.pit.errors import MotionError, PitError, WorkLimitError
from pep.pit.grip import grip_causes
from pep.pit.motion import GripperMove, MoveJ
from pep.pit.moves import MoveQuestion
from pep.pit.oracle import Disagreement
from pep.pit.tier import MOVING, tier_of
from pep.pit.view import view_of
from policies.evidence import Contribution, ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.cell import CellParameters
    from pep.pit.motion import Motion
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene
    from pep.pit.view import View

LEAST_RATE: Final = 1e-6  # one unit of the wire (urad/s); less would underflow to "does not move"


def assess(
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    *,
    perception_age_s: float | None,
    seed: bytes,
    clock: Callable[[], float] = time.monotonic,
) -> Assessment | ImpactFault:
    """What `motion` could do in `scene`. Never raises.

    Args:
        robot: the arm with its tool; must be the tool that the cell names.
        scene: the newest valid view, or None when there is none.
        motion: what would be sent.
        cell: the cell's parameters.
        perception_age_s: age of the view, or None when there is none.
        seed: digest of the command; picks the configurations at which the second engine is asked.
        clock: monotonic seconds; the answer comes within `cell.time_limit_s` or is a fault.
    """
    try:
        return _assess(robot, scene, motion, cell, age_s=perception_age_s, seed=seed, clock=clock)
    except PitError as error:
        return ImpactFault(error.reason, error.detail)
    except Exception as error:  # noqa: BLE001 - whatever breaks in here must end in a denial, not in the caller
        frames = traceback.extract_tb(error.__traceback__)
        return ImpactFault("PHYSICS_FAULT", f"{type(error).__name__} in {frames[-1].name}")


def _assess(
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    *,
    age_s: float | None,
    seed: bytes,
    clock: Callable[[], float],
) -> Assessment | ImpactFault:
    until = clock() + cell.time_limit_s

    def check_time() -> None:
        if not clock() <= until:
            raise WorkLimitError("PHYSICS_FAULT", "no answer in time")

    # Refuse before any arithmetic: a NaN would compare as "far enough".
    wrong = cell.defect()
    if wrong is not None:
        return ImpactFault("PHYSICS_FAULT", wrong)
    if cell.tool != robot.tool.name:
        return ImpactFault("PHYSICS_FAULT", "the robot carries another tool than the cell says")
    _refuse_nonsense(motion)
    view = view_of(scene, age_s, cell)
    match motion:
        case MoveJ():
            return MoveQuestion(robot, view, motion, cell, seed=seed, check_time=check_time).answer()
        case GripperMove():
            return _grip_answer(robot, view, motion, cell)
        case _:
            assert_never(motion)


def _refuse_nonsense(motion: Motion) -> None:
    """Every number finite, every rate above 0, six joints.

    Raises:
        MotionError: otherwise.
    """
    joints: tuple[tuple[float, ...], ...]
    match motion:
        case MoveJ():
            joints = (motion.start, motion.target)
            rates = (motion.speed_rad_s, motion.acceleration_rad_s2)
        case GripperMove():
            joints = (motion.q,)
            rates = (motion.speed_m_s, motion.force_n)
            if not (math.isfinite(motion.width_m) and motion.width_m >= 0):
                raise MotionError("NOT_FINITE" if not math.isfinite(motion.width_m) else "OUT_OF_RANGE", "width")
        case _:
            assert_never(motion)
    for row in joints:
        if len(row) != 6:  # a UR arm's joints
            raise MotionError("PARAMETERS_WRONG", "six joint angles are needed")
        if not all(math.isfinite(angle) for angle in row):
            raise MotionError("NOT_FINITE", "a joint angle")
    if not all(math.isfinite(rate) for rate in rates):
        raise MotionError("NOT_FINITE", "a speed, acceleration or force")
    if not all(rate >= LEAST_RATE for rate in rates):
        raise MotionError("OUT_OF_RANGE", "a speed, acceleration or force below the least that a request can spell")


def _grip_answer(robot: Robot, view: View, motion: GripperMove, cell: CellParameters) -> Assessment | ImpactFault:
    causes = grip_causes(robot, view, motion, cell)
    if isinstance(causes, Disagreement):
        return ImpactFault("ENGINES_DISAGREE", causes.what)
    finger_speed = micro(motion.speed_m_s)
    told = [
        Contribution(c.kind, milli(c.index), "gripper", c.object, 0, micro(c.clearance_m), finger_speed)
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
        contact_ratio=contact_ratio(view.scene.people, robot, cell, speed_m_s=motion.speed_m_s),
        start=motion.q,
        certificate=EMPTY_CERTIFICATE,
        perception=view.perception,
        perception_age_s=view.age_s,
        engine=ENGINE,
        model_digest=robot.model_digest,
        scene_digest=view.scene.digest,
    )

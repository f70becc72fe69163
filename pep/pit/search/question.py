"""Checks of every question before anything is computed.

A NaN would compare as "far enough".
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, assert_never

from pep.pit.base.errors import MotionError, PitError, WorkLimitError
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointLeg,
    JointPath,
    JointTrajectory,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
    run_of,
)
from pep.pit.base.timed_points import refuse_untimed
from pep.pit.scene.grip_sightings import without_held
from pep.pit.scene.view import view_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Joints, Motion, Pose, Run
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene
    from pep.pit.scene.view import View

LEGS_MOST: Final = 256  # of one path; more is a program, and none is a path
LARGEST: Final = 200.0  # m, m/s, m/s2, rad/s, s: about a tool; above every cap of the client (U12: 150 m/s2)
LONGEST_TURN_RAD: Final = 2 * math.pi  # of a rotation vector; a longer one is another pose than it says
LEAST_RATE: Final = 1e-6  # one unit of the wire (urad/s); less would underflow to "does not move"
JOINTS: Final = 6  # of a UR arm


def deadline(clock: Callable[[], float], limit_s: float) -> Callable[[], None]:
    """A function that raises `WorkLimitError` once `limit_s` have passed, or the clock is none."""
    until = clock() + limit_s

    def check_time() -> None:
        if not clock() <= until:
            raise WorkLimitError("PHYSICS_FAULT", "no answer in time")

    return check_time


def refuse_nonsense(robot: Robot, motion: Motion, cell: CellParameters, touch: frozenset[str]) -> None:
    """Checks that the cell fits itself and the robot, and that the motion's numbers are possible.

    Every number is finite, every rate above 0, and there are six joints.

    Raises:
        PitError: otherwise.
    """
    wrong = cell.defect()
    if wrong is not None:
        raise PitError("PHYSICS_FAULT", wrong)
    if cell.tool != robot.tool.name:
        raise PitError("PHYSICS_FAULT", "the robot carries another tool than the cell says")
    # A bare string would grant each of its substrings.
    if not isinstance(touch, frozenset):
        raise PitError("PHYSICS_FAULT", "what may be touched is a set of names")
    refuse_unreal(motion)


def refuse_unreal(motion: Motion) -> None:
    """Checks that every number is finite, every rate at least the least of a request, and joints are six.

    Raises:
        MotionError: otherwise.
    """
    joints: tuple[tuple[float, ...], ...]
    rates: tuple[float, ...]
    poses: tuple[tuple[float, ...], ...] | None = None  # of a tool, when the motion speaks of one
    match motion:
        case MoveJ():
            joints = (motion.start, motion.target)
            rates = (motion.speed_rad_s, motion.acceleration_rad_s2)
        case SpeedJ():
            joints = (motion.start, motion.qd_rad_s)
            rates = (motion.acceleration_rad_s2, motion.duration_s)
        case MoveL():
            joints = (motion.start,)
            rates = (motion.speed_m_s, motion.acceleration_m_s2)
            poses = (motion.target,) if motion.stated_start is None else (motion.target, motion.stated_start)
        case SpeedL():
            joints = (motion.start, motion.twist)
            rates = (motion.acceleration_m_s2, motion.duration_s)
            poses = ()
        case ServoJ():
            joints = (motion.start, motion.qd_rad_s, motion.target)
            rates = (motion.period_s, motion.lookahead_s)
        case JointPath():
            _refuse_legs(tuple(leg.blend_m for leg in motion.legs))
            joints = (motion.start, *(leg.target for leg in motion.legs))
            rates = tuple(rate for leg in motion.legs for rate in (leg.speed_rad_s, leg.acceleration_rad_s2))
        case LinePath():
            _refuse_legs(tuple(leg.blend_m for leg in motion.legs))
            joints = (motion.start,)
            rates = tuple(rate for leg in motion.legs for rate in (leg.speed_m_s, leg.acceleration_m_s2))
            poses = tuple(leg.target for leg in motion.legs)
        case JointTrajectory():
            refuse_untimed(motion)
            joints = (*motion.points, *motion.speeds)
            rates = ()
        case BlendedPath():
            joints, rates, poses = _mixed(motion)
        case GripperMove():
            joints = (motion.q,)
            rates = (motion.speed_m_s, motion.force_n)
            if not (math.isfinite(motion.width_m) and motion.width_m >= 0):
                raise MotionError("NOT_FINITE" if not math.isfinite(motion.width_m) else "OUT_OF_RANGE", "width")
        case OutputSet():
            # True is an int and 1.0 equals 1: neither is a pin, and 1 is no level.
            if not (type(motion.pin) is int and isinstance(motion.value, bool)):
                raise MotionError("PARAMETERS_WRONG", "a pin is a whole number and its value true or false")
            return
        case _:
            assert_never(motion)
    for row in (*joints, *(poses or ())):
        six_finite(row)
    if not all(math.isfinite(rate) for rate in rates):
        raise MotionError("NOT_FINITE", "a speed, acceleration, time or force")
    if not all(rate >= LEAST_RATE for rate in rates):
        raise MotionError("OUT_OF_RANGE", "a speed, acceleration, time or force below the least that can be spelt")
    if isinstance(motion, SpeedJ | SpeedL):
        held = motion.qd_rad_s if isinstance(motion, SpeedJ) else motion.twist
        if 0 < max(map(abs, held)) < LEAST_RATE:
            raise MotionError("OUT_OF_RANGE", "speeds below the least that can be spelt")
    if poses is not None:
        twist = motion.twist if isinstance(motion, SpeedL) else ()
        _refuse_vast((*rates, *twist, *(part for pose in poses for part in pose[:3])), poses)


def _mixed(path: BlendedPath) -> tuple[tuple[Joints, ...], tuple[float, ...], tuple[Pose, ...]]:
    """Joint angles, rates and poses of a path.

    Raises:
        MotionError: no legs or too many, a blend that is no radius, or one at the end, where nothing follows.
    """
    blends = tuple(leg.blend_m for leg in path.legs)
    _refuse_legs(tuple(0.0 * blend for blend in blends))
    if not (all(blend >= 0 for blend in blends) and blends[-1] == 0):
        raise MotionError("OUT_OF_RANGE", "a blend below 0, or one at the end of a path")
    joints = [leg for leg in path.legs if isinstance(leg, JointLeg)]
    lines = [leg for leg in path.legs if isinstance(leg, LineLeg)]
    rates = [rate for leg in joints for rate in (leg.speed_rad_s, leg.acceleration_rad_s2)]
    rates += [rate for leg in lines for rate in (leg.speed_m_s, leg.acceleration_m_s2)]
    return (path.start, *(leg.target for leg in joints)), tuple(rates), tuple(leg.target for leg in lines)


def _refuse_vast(sizes: tuple[float, ...], poses: tuple[tuple[float, ...], ...]) -> None:
    """Refuses a tool with numbers beyond all measure.

    Raises:
        MotionError: otherwise.
    """
    if not max(map(abs, sizes)) <= LARGEST:
        raise MotionError("OUT_OF_RANGE", "a place, speed, acceleration or time that no tool has")
    if not all(math.hypot(*pose[3:]) <= LONGEST_TURN_RAD for pose in poses):
        raise MotionError("OUT_OF_RANGE", "a turn of more than once round")


def _refuse_legs(blends: tuple[float, ...]) -> None:
    """Checks that there are some legs, not too many, none of which is blended into the next.

    Raises:
        MotionError: otherwise.
    """
    if not 0 < len(blends) <= LEGS_MOST:
        raise MotionError("PARAMETERS_WRONG", "a path without legs, or with too many")
    if not all(math.isfinite(blend) for blend in blends):
        raise MotionError("NOT_FINITE", "a blend")
    # With a blend the arm cuts the corner, and nobody but the controller knows how.
    if any(blends):
        raise MotionError("OUT_OF_RANGE", "blends are not assessed")


def six_finite(row: tuple[float, ...]) -> None:
    """Six finite numbers.

    Raises:
        MotionError: otherwise.
    """
    if len(row) != JOINTS:
        raise MotionError("PARAMETERS_WRONG", "six joint angles are needed")
    if not all(math.isfinite(angle) for angle in row):
        raise MotionError("NOT_FINITE", "a joint angle or speed")


def as_run(motion: MoveJ | SpeedJ, cell: CellParameters) -> Run:
    """The motion as a straight run to the end of this cell's stop."""
    return run_of(motion, stop_delay_s=cell.stop_delay_s, stop_deceleration_rad_s2=cell.stop_deceleration_rad_s2)


def view_around(
    robot: Robot, scene: Scene | None, age_s: float | None, q: Joints, cell: CellParameters, *, lag_m: float = 0.0
) -> View:
    """View for a decision about the arm at `q`, without the held object in its gripper.

    Args:
        robot: with what it holds.
        scene: the newest valid view, or None.
        age_s: its age.
        q: measured joint angles, rad.
        cell: tolerances.
        lag_m: distance of the held object from its seen place, at most.
    """
    if scene is not None:
        seen = view_of(scene, age_s, cell)  # refuses a scene that must not be reasoned about before it is taken apart
        scene = without_held(scene, robot, q, tolerance_m=cell.held_tolerance_m + lag_m)
        if scene is seen.scene:
            return seen
    return view_of(scene, age_s, cell)

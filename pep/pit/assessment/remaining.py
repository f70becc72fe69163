"""Question of the watch: is the rest of a running motion still inside the authorised index, and at which speed?

Only the way from the arm's measured place counts, with the rates that the motion's own profile can still have there.
The answer is yes or no with a proof of the yes, found by the same search as `assess` and left as soon as either is
certain; there is no second engine here. A question without an answer is a fault, and a watch stops on it.
"""

from __future__ import annotations

import time
import traceback
from typing import TYPE_CHECKING, assert_never

import numpy as np

from pep.pit.assessment.assessment import milli
from pep.pit.assessment.course_remaining import rests_of
from pep.pit.assessment.grip_assessment import gripping
from pep.pit.assessment.output_index import output_cause
from pep.pit.assessment.readiness import compile_all
from pep.pit.assessment.slider_search import paced
from pep.pit.assessment.straight_remaining import (
    FULL,
    OFF_PATH,
    PERCEPTION,
    Pace,
    Remaining,
    RemainingRun,
    against,
    strays_m,
)
from pep.pit.base.errors import MotionError, PitError
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
from pep.pit.base.tier import HIGHEST
from pep.pit.scene.view import view_of
from pep.pit.search.question import as_run, deadline, refuse_nonsense, six_finite
from pep.pit.second.straight_check import Disagreement
from policies.evidence.evidence import ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.assessment.straight_remaining import RemainingMotion
    from pep.pit.base.motion import Joints, Motion
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene
    from pep.pit.scene.view import View

__all__ = ["Pace", "Remaining", "remaining"]


def remaining(
    robot: Robot,
    scene: Scene | None,
    move: Motion,
    cell: CellParameters,
    *,
    at_rad: Joints,
    authorised_milli: int,
    perception_age_s: float | None,
    touch: frozenset[str],
    running: float | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Remaining | ImpactFault:
    """Judgement of the rest of `move` against the authorised index. Never raises.

    With `running` it is asked at that fraction of the commanded speed, and the highest speed at which it would be is
    told too (PHY-50). A motion whose end is a stop of its own (a held speed, a servo target) is asked at full speed.

    Args:
        robot: the arm with its tool and what that holds, as it was when `move` was decided.
        scene: the newest valid view, or None when there is none.
        move: the motion under way, as it was assessed: from its start.
        cell: the cell's parameters.
        at_rad: measured joint angles, rad. Farther than `cell.tracking_tolerance_m` from the path is off the path.
        authorised_milli: index that the decision authorised, 0 to 4000 thousandths.
        perception_age_s: age of the view, or None; enters the reaction time (PHY-2).
        touch: names of objects that the token grants to touch.
        running: highest fraction of the commanded speed that the arm can have now, above 0 and at most 1; None when
            nothing can slow it down: it counts as at full speed, and no other speed is looked for.
        clock: monotonic seconds; the answer comes within `cell.watch_time_limit_s` or is a fault.
    """
    try:
        compile_all()  # compiled, where it is the first call of all, before the time is counted
        check_time = deadline(clock, cell.watch_time_limit_s)
        spare = deadline(clock, cell.pacing_time_limit_s)
        answer = _remaining(
            robot,
            scene,
            move,
            cell,
            at_rad=at_rad,
            authorised_milli=authorised_milli,
            age_s=perception_age_s,
            touch=touch,
            running=running,
            check_time=check_time,
            spare=spare,
        )
        check_time()  # a late answer is about an arm that is elsewhere by now
        return answer  # noqa: TRY300 - the check above belongs to the answer
    except PitError as error:
        return ImpactFault(error.reason, error.detail)
    except Exception as error:  # noqa: BLE001 - any failure in here must stop the arm, not the watch
        frames = traceback.extract_tb(error.__traceback__)
        return ImpactFault("PHYSICS_FAULT", f"{type(error).__name__} in {frames[-1].name}")


def _remaining(
    robot: Robot,
    scene: Scene | None,
    move: Motion,
    cell: CellParameters,
    *,
    at_rad: Joints,
    authorised_milli: int,
    age_s: float | None,
    touch: frozenset[str],
    running: float | None,
    check_time: Callable[[], None],
    spare: Callable[[], None],
) -> Remaining | ImpactFault:
    refuse_nonsense(robot, move, cell, touch)
    six_finite(at_rad)
    if not (type(authorised_milli) is int and 0 <= authorised_milli <= milli(HIGHEST)):
        raise MotionError("PARAMETERS_WRONG", "an authorised index that is none")
    if running is not None and not 0 < running <= FULL:
        raise MotionError("PARAMETERS_WRONG", "a fraction of the speed that is none")

    def told(left: RemainingMotion, *, stretches: bool) -> Remaining:
        """Answer for the watch.

        `stretches`: the slider changes nothing but the motion's duration.
        """
        early = left.prepare(scene, age_s, touch)
        if early is not None:
            return early
        return paced(left, cell, running, spare=spare) if stretches and running is not None else left.at(FULL)

    match move:
        case MoveJ() | SpeedJ():
            run = as_run(move, cell)
            rest = RemainingRun(
                robot, run, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time
            )
            return told(rest, stretches=isinstance(move, MoveJ))
        case MoveL() | SpeedL() | ServoJ() | JointPath() | LinePath() | JointTrajectory() | BlendedPath():
            rests = rests_of(
                robot,
                move,
                cell,
                at_rad=at_rad,
                authorised_milli=authorised_milli,
                age_s=age_s or 0.0,
                check_time=check_time,
            )
            return told(rests, stretches=not isinstance(move, SpeedL | ServoJ | JointTrajectory))
        case GripperMove():
            if not strays_m(robot, np.array(at_rad) - np.array(move.q)) <= cell.tracking_tolerance_m:
                return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
            return _grip(robot, view_of(scene, age_s, cell), move, cell, authorised_milli)
        case OutputSet():
            output = output_cause(move, cell)
            return against(authorised_milli, output.index_milli, output.kind)
        case _:
            assert_never(move)


def _grip(
    robot: Robot, view: View, move: GripperMove, cell: CellParameters, authorised_milli: int
) -> Remaining | ImpactFault:
    """Answer for a gripper move, which is short: all of it is asked again, at the arm's rest."""
    grip = gripping(robot, view, move, cell)
    if isinstance(grip, Disagreement):
        return ImpactFault("ENGINES_DISAGREE", grip.what)
    worst = grip.causes[0]
    if view.floor > worst.index:
        return against(authorised_milli, milli(view.floor), PERCEPTION)
    return against(authorised_milli, milli(worst.index), worst.kind)

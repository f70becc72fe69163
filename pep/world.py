"""The world of TEA-4: what the sensors sign, where the robot says it is, and what physics makes of a request there."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, assert_never

from capabilities.units import si
from pep.context.frames import Distrusted, Seen, Unseen
from pep.errors import RobotError
from pep.operations import GRIPPER_MOVE, MOVE_JOINT
from pep.pit import Assessment, GripperMove, MoveJ, Scene, SceneError, assess
from policies.evidence import ImpactFault, ImpactReading
from policies.reasons import Reason

if TYPE_CHECKING:
    from capabilities.statements.observation import Observation
    from pep.context.frames import Frames
    from pep.pit import CellParameters, Motion, Robot
    from pep.rtde.state import JointState, RobotState
    from policies.model import Request

STARTS_KEPT: Final = 64
"""Requests whose start is remembered; one at a time is under way."""


class CellPhysics:
    """The `Physics` port: one reading of perception and robot, one assessment.

    Args:
        robot: its model.
        cell: its parameters and surveyed objects.
        frames: the believed perception.
        state: what the robot says about itself.
    """

    def __init__(self, *, robot: Robot, cell: CellParameters, frames: Frames, state: RobotState) -> None:
        self._robot = robot
        self._cell = cell
        self._frames = frames
        self._state = state
        self._lock = threading.Lock()
        self._starts: OrderedDict[str, tuple[float, ...]] = OrderedDict()

    def assess(self, request: Request) -> ImpactReading | ImpactFault:
        """The runtime impact of the request in the world as it is now, or why none can be told."""
        try:
            return self._assess(request)
        except RobotError as error:
            return ImpactFault(Reason.PHYSICS_FAULT, str(error.code))
        except SceneError as error:
            return ImpactFault(Reason.PERCEPTION_INVALID, error.detail)
        except Exception as error:  # noqa: BLE001 - whatever breaks in physics is a fault, never a tier
            return ImpactFault(Reason.PHYSICS_FAULT, type(error).__name__)

    def _assess(self, request: Request) -> ImpactReading | ImpactFault:
        view = self._frames.view()
        scene: Scene | None
        age_s: float | None
        match view:
            case Distrusted(rejected):
                return ImpactFault(Reason.PERCEPTION_INVALID, f"{rejected.sensor[:64]} {rejected.fault}")
            case Unseen():
                scene, age_s = None, None
            case Seen(frames, age_ms):
                age_s = age_ms / 1000
                scene = Scene.from_observation(_merged([frame.observation for frame in frames]), self._cell)
            case _:
                assert_never(view)
        state = self._state.read()
        if not state.still:
            return ImpactFault(Reason.BUSY, "the arm is moving")
        motion = _motion(request, state)
        if motion is None:
            return ImpactFault(Reason.PHYSICS_FAULT, "no physics is known for the operation")
        with self._lock:
            self._starts[request.request_id] = state.q_rad
            while len(self._starts) > STARTS_KEPT:
                self._starts.popitem(last=False)
        assessed = assess(
            self._robot,
            scene,
            motion,
            self._cell,
            perception_age_s=age_s,
            touch=frozenset(),
            seed=bytes.fromhex(request.digest),
        )
        match assessed:
            case ImpactFault():
                return assessed
            case Assessment():
                return assessed.reading()
            case _:
                assert_never(assessed)

    def start_of(self, request_id: str) -> tuple[float, ...] | None:
        """The joint angles (rad) from which that request was assessed, or None when it was not."""
        with self._lock:
            return self._starts.get(request_id)

    def summary(self) -> dict[str, Any]:
        """What is seen, for people who look: how many, how old, whether it is believed."""
        view = self._frames.view()
        match view:
            case Distrusted():
                return {"perception": "invalid", "age_ms": None, "people": None, "objects": None}
            case Unseen():
                return {"perception": "missing", "age_ms": None, "people": None, "objects": None}
            case Seen(frames, age_ms):
                limit_ms = self._cell.perception_age_limit_s * 1000
                return {
                    "perception": "fresh" if age_ms <= limit_ms else "stale",
                    "age_ms": age_ms,
                    "people": sum(len(frame.observation.people) for frame in frames),
                    "objects": sum(len(frame.observation.objects) for frame in frames),
                }
            case _:
                assert_never(view)


def _merged(observations: list[Observation]) -> Observation:
    """Everything that any sensor sees; complete only where all of them are."""
    first, *others = observations
    return replace(
        first,
        complete=all(o.complete for o in observations),
        people=first.people + tuple(person for o in others for person in o.people),
        objects=first.objects + tuple(thing for o in others for thing in o.objects),
    )


def _motion(request: Request, state: JointState) -> Motion | None:
    values = tuple(si(v.value, v.unit) for v in request.values)
    if request.operation == MOVE_JOINT.name:
        return MoveJ(state.q_rad, values[:6], values[6], values[7])  # type: ignore[arg-type]  # six joints, counted where they were read
    if request.operation == GRIPPER_MOVE.name:
        return GripperMove(state.q_rad, values[0], values[1], values[2])  # type: ignore[arg-type]
    return None

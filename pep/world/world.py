"""World of TEA-4: the sensors' signed view, the robot's own place, and the physics of a request there."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar, assert_never

import numpy as np

from capabilities.values.scope import Tier
from capabilities.values.units import Unit, si
from pep.base.errors import RobotError
from pep.base.operation_row import Moves
from pep.base.operations import operation_of, targets_of
from pep.base.ports import Assessed, RemainingVerdict, Together
from pep.base.stop_model import patience_s
from pep.perception.sensor_frames import Distrusted, Seen, Unseen
from pep.pit import (
    BlendedPath,
    GripperMove,
    JointLeg,
    JointPath,
    JointTrajectory,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    Scene,
    SceneError,
    ServoJ,
    SpeedJ,
    SpeedL,
    assess,
    remaining,
    scene_observed,
)
from pep.pit.assessment.led_motion import AGAIN_S, LedView
from pep.pit.base.errors import MotionError, UnprovenError
from pep.pit.base.timed_points import refuse_untimed
from pep.pit.files.scene_file import Situation
from pep.pit.robot.inverse_kinematics import followed, joint_speeds
from pep.pit.robot.kinematics import link_frames
from pep.pit.search.contact_way import contact_speed, until_contact
from pep.pit.search.speed_envelope import moves_with, stream_envelope
from pep.world.arrival import arrived
from pep.world.led_request import force_of, led_by
from pep.world.questions import AssessedQuestions
from pep.world.timed_request import refuse_elsewhere, refuse_faster, trajectory_of
from pep.world.waypoints import through_waypoints
from policies.evidence.evidence import ImpactFault, ImpactReading
from policies.evidence.tiers import FRESH
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.base.ports import Clock
    from pep.perception.sensor_frames import Frames, Look
    from pep.pit import CellParameters, Motion, Remaining, Robot
    from pep.rtde.robot.state_receiver import JointState, RobotState
    from pep.world.held_object import CommittedGrip
    from policies.evidence.model import Request

MOTIONS_KEPT: Final = 64
"""Requests whose motion is remembered; one at a time is under way."""
MILLI: Final = 1_000
ALLOWANCE: Final = 1.5
"""Factor by which a second assessment may outlast the first; a slower one is a fault. Ours."""

T = TypeVar("T")


class CellPhysics:
    """The `Physics` and `Remaining` ports: one look at perception and robot, one assessment.

    Args:
        holding: its model, with what it holds.
        cell: its parameters and surveyed objects.
        valid_until_s: end of the signed cell file that they come from, seconds since the epoch.
        frames: the believed perception.
        state: the robot's state.
        clock: ages on its monotonic, the cell file's end on its wall time.
    """

    def __init__(
        self,
        *,
        holding: CommittedGrip,
        cell: CellParameters,
        valid_until_s: int,
        frames: Frames,
        state: RobotState,
        clock: Clock,
    ) -> None:
        self._holding = holding
        self._cell = cell
        self._valid_until_s = valid_until_s
        self._frames = frames
        self._state = state
        self._clock = clock
        self._lock = threading.Lock()
        self._motions: OrderedDict[str, Motion] = OrderedDict()
        self._until_s: dict[str, float] = {}  # of the motions that go on until a contact
        self.questions = AssessedQuestions()

    def assess(self, request: Request, *, touch: frozenset[str]) -> Assessed:
        """Runtime impact of the request in the world as it is now, or a fault, with the view's origin.

        People walk on while it is computed, so the age at the end counts. An answer that took longer than it allowed
        for is discarded, and the world is looked at anew with that much more age.
        """
        allowance_ms = 0
        while True:
            look = self._frames.look()
            impact = _told(partial(self._assess, request, look, touch, allowance_ms=allowance_ms))
            now_ms = self._clock.monotonic_ms()
            if self._in_time(impact, look, now_ms):
                break
            if allowance_ms:
                impact = ImpactFault(Reason.PHYSICS_FAULT, "the assessment is slower than the world")
                break
            allowance_ms = max(1, math.ceil((now_ms - look.taken_ms) * ALLOWANCE))
        if isinstance(impact, ImpactReading):
            impact = replace(impact, perception_age_ms=look.age_ms(now_ms))
        else:
            self.questions.forget(request.request_id)  # an earlier look, or try, may have been answered
        return Assessed(impact, look.reading(now_ms=now_ms, limit_ms=self._limit_ms))

    @property
    def _limit_ms(self) -> int:
        return int(self._cell.perception_age_limit_s * 1000)

    def _in_time(self, impact: ImpactReading | ImpactFault, look: Look, now_ms: int) -> bool:
        """True where the impact was computed for the view's age at the end."""
        age_ms = look.age_ms(now_ms)
        if isinstance(impact, ImpactFault) or impact.perception_age_ms is None or age_ms is None:
            return True
        fresh, seen = impact.perception == FRESH, look.view()
        sighting_ms = look.sighting_age_ms(now_ms)
        if fresh and sighting_ms is not None and sighting_ms > self._limit_ms:
            return False
        if isinstance(seen, Seen) and not any(frame.observation.people for frame in seen.frames):
            return True  # no person walks, and the view's own floor does not depend on its age
        # A fresh view includes this reaction anyway (PHY-2); in an older one people have grown with its age.
        reckoned_ms = int(self._cell.watch_age_limit_s * 1000) if fresh else 0
        return age_ms <= max(reckoned_ms, impact.perception_age_ms)

    def _assess(
        self, request: Request, look: Look, touch: frozenset[str], *, allowance_ms: int
    ) -> ImpactReading | ImpactFault:
        if not self._clock.wall_s() < self._valid_until_s:
            return ImpactFault(Reason.PHYSICS_FAULT, "the signed cell file has expired")
        sight = sight_of(look, self._cell, allowance_ms=allowance_ms)
        if isinstance(sight, ImpactFault):
            return sight
        state = self._state.read()
        if not state.still and not _goes_on(request, state):
            return ImpactFault(Reason.BUSY, "the arm is moving")
        robot, seed = self._holding.robot, bytes.fromhex(request.digest)
        around = Situation(self._cell, sight.scene, sight.age_s, robot.held, touch)
        led = led_by(request)
        if led is not None:
            # It begins where the arm stands; its envelope is around that.
            still = MoveJ(state.q_rad, state.q_rad, 1.0, 1.0)  # type: ignore[arg-type]  # as below
            self._keep(request, still)
            self.questions.keep(request.request_id, robot, around, still, None)
            view = LedView(sight.scene, sight.age_s, self._cell, touch)
            return view.reading(led, robot, state.q_rad, force_n=force_of(request), seed=seed)
        motion = _motion(request, state, robot, self._cell)
        if isinstance(motion, SpeedL) and _until_contact(request):
            asked_m_s = math.hypot(*(si(v.value, v.unit) for v in request.quantities[:3]))
            patience = patience_s(self._cell.stop_deceleration_rad_s2)
            motion, self._until_s[request.request_id] = until_contact(
                robot, motion, sight.scene, self._cell, touch=touch, speed_m_s=asked_m_s, patience_s=patience
            )
        if motion is None:
            return ImpactFault(Reason.PHYSICS_FAULT, "no physics is known for the operation")
        self._keep(request, motion)
        assessed = assess(robot, sight.scene, motion, self._cell, perception_age_s=sight.age_s, touch=touch, seed=seed)
        if isinstance(assessed, ImpactFault):
            return assessed
        self.questions.keep(request.request_id, robot, around, motion, assessed)
        return assessed.reading()

    def _keep(self, request: Request, motion: Motion) -> None:
        with self._lock:
            self._motions[request.request_id] = motion
            while len(self._motions) > MOTIONS_KEPT:
                over, _ = self._motions.popitem(last=False)
                self._until_s.pop(over, None)

    def remember(self, request: Request) -> None:
        """Keeps a motion as `Physics.remember` says. A motion that cannot be derived begins nowhere, and is refused."""
        _told(partial(self._remember, request))

    def _remember(self, request: Request) -> None:
        motion = _motion(request, self._state.read(), self._holding.robot, self._cell)
        if motion is not None:
            self._keep(request, motion)

    def together(
        self, request: Request, *, start_urad: tuple[int, ...], touch: frozenset[str]
    ) -> Together | ImpactFault:
        """Judges the rest of a straight move from the arm's place; the part behind it is done."""
        return _told(partial(self._together, request, start_urad, touch))

    def _together(self, request: Request, start_urad: tuple[int, ...], touch: frozenset[str]) -> Together | ImpactFault:
        cell = replace(self._cell, watch_time_limit_s=self._cell.time_limit_s)  # nothing moves yet
        sight = sight_of(self._frames.look(), self._cell)
        if isinstance(sight, ImpactFault):
            return sight
        state = self._state.read()
        start = tuple(si(angle, Unit.MICRORADIAN) for angle in start_urad)
        motion = _motion(request, replace(state, q_rad=start), self._holding.robot, cell)
        if motion is None:
            return ImpactFault(Reason.PHYSICS_FAULT, "no physics is known for the operation")
        for tier in Tier:
            rest = remaining(
                self._holding.robot,
                sight.scene,
                motion,
                cell,
                at_rad=state.q_rad,  # type: ignore[arg-type]  # six, counted where they were read
                authorised_milli=tier * MILLI,
                perception_age_s=sight.age_s,
                touch=touch,
            )
            if isinstance(rest, ImpactFault):
                return rest
            if rest.holds:
                return Together(rest.index_milli)
        return Together(max(Tier) * MILLI)

    def motion_of(self, request_id: str) -> Motion | None:
        """The motion that was assessed for that request; None when none was."""
        with self._lock:
            return self._motions.get(request_id)

    def start_of(self, request_id: str) -> tuple[float, ...] | None:
        """The joint angles (rad) from which that request was assessed, or None when it was not."""
        motion = self.motion_of(request_id)
        match motion:
            case None | OutputSet():
                return None
            case (
                MoveJ()
                | SpeedJ()
                | MoveL()
                | SpeedL()
                | ServoJ()
                | JointPath()
                | LinePath()
                | JointTrajectory()
                | BlendedPath()
            ):
                return motion.start
            case GripperMove():
                return motion.q
            case _:
                assert_never(motion)

    def arrived(self, request_id: str, q_rad: Sequence[float]) -> bool:
        """True where these joint angles (rad) are the end of that request's motion, as it was assessed."""
        return arrived(self.motion_of(request_id), self._holding.robot, q_rad)

    def held_s(self, request_id: str) -> float:
        """Time for which that request's tool may go on until a contact, s; 0 where it was not assessed."""
        return self._until_s.get(request_id, 0.0)

    def left(
        self,
        request: Request,
        state_q_rad: Sequence[float],
        *,
        authorised_milli: int,
        touch: frozenset[str],
        running: float | None,
        oldest_ms: int | None,
    ) -> RemainingVerdict:
        """Judges whether the rest of a motion from these joint angles is proven to be inside the authorised index.

        The `Remaining` port: one look at the frames, one judgement; it never raises.
        """
        look = self._frames.look(oldest_ms=oldest_ms)
        age_ms = look.age_ms(look.taken_ms)

        def ask() -> Remaining | ImpactFault:
            sight = sight_of(look, self._cell)
            with self._lock:
                motion = self._motions.get(request.request_id)
            if isinstance(sight, ImpactFault):
                return sight
            if motion is None:
                return ImpactFault(Reason.PHYSICS_FAULT, "")
            return remaining(
                self._holding.robot,
                sight.scene,
                motion,
                self._cell,
                at_rad=tuple(state_q_rad),  # type: ignore[arg-type]  # six, counted where they were read
                authorised_milli=authorised_milli,
                perception_age_s=sight.age_s,
                touch=touch,
                running=running,
            )

        rest = _told(ask)
        if isinstance(rest, ImpactFault):
            return RemainingVerdict(holds=False, index_milli=None, cause=rest.detail, fault=rest.reason, age_ms=age_ms)
        view = look.view()
        shown = view.content if isinstance(view, Seen) else None
        pace = None if rest.pace is None else rest.pace.fraction
        return RemainingVerdict(
            rest.holds, rest.index_milli, rest.cause, fault="", age_ms=age_ms, shown=shown, pace=pace
        )

    def grip_ended(self, *, on_something: bool, arrived: bool) -> None:
        """Commits the held object after a grip has ended, by the gripper's word and the sensors' view.

        Args:
            on_something: whether the fingers were stopped by something.
            arrived: whether the move of the fingers ended by itself. Fingers that were halted say nothing of what they
                hold: what was held before still is.

        Raises:
            RobotError: the arm says nothing; what it holds is then unknown.
            SceneError: the view cannot be read; likewise.
        """
        if not arrived and self._holding.held is not None:
            return
        if not on_something:
            self._holding.released()
            return
        self._holding.closed_on_unknown()
        seen = self._frames.view()
        if isinstance(seen, Seen):
            shown = scene_of(seen, self._cell).objects[len(self._cell.objects) :]
            self._holding.closed_on(self._state.read().q_rad, shown)  # type: ignore[arg-type]  # six, counted where they were read

    def summary(self) -> dict[str, Any]:
        """Summary of the view for people: how many, how old, whether it is believed."""
        look = self._frames.look()
        view = look.view()
        match view:
            case Distrusted():
                return {"perception": "invalid", "age_ms": None, "people": None, "objects": None}
            case Unseen():
                return {"perception": "missing", "age_ms": None, "people": None, "objects": None}
            case Seen(frames, age_ms):
                complete = FRESH if view.complete else "missing"
                return {
                    "perception": complete if (look.sighting_age_ms(look.taken_ms) or 0) <= self._limit_ms else "stale",
                    "age_ms": age_ms,
                    "people": sum(len(frame.observation.people) for frame in frames),
                    "objects": sum(len(frame.observation.objects) for frame in frames),
                }
            case _:
                assert_never(view)


def tool_position(robot: Robot, q_rad: Sequence[float]) -> tuple[float, float, float]:
    """Tool centre point of the model, m in the base frame, at six joint angles."""
    rotation, origin = link_frames(robot, np.array([q_rad], dtype=float))
    x, y, z = (origin[0, -1] + rotation[0, -1] @ np.array(robot.tool.tcp_m)).tolist()
    return x, y, z


@dataclass(frozen=True, slots=True)
class AgedScene:
    """The scene to reason about and its age in seconds; both None when there is no view."""

    scene: Scene | None
    age_s: float | None


def sight_of(look: Look, cell: CellParameters, *, allowance_ms: int = 0) -> AgedScene | ImpactFault:
    """Scene of a look with the age to compute with; or the reason why it must not be believed.

    Args:
        look: at the sensors.
        cell: its surveyed objects.
        allowance_ms: time that the question is given.

    Raises:
        SceneError: a region or kind that is not in the declared sets.
    """
    view = look.view()
    match view:
        case Distrusted(rejected):
            return ImpactFault(Reason.PERCEPTION_INVALID, f"{rejected.sensor[:64]} {rejected.fault}")
        case Unseen():
            return AgedScene(None, None)
        case Seen() as seen:
            return AgedScene(scene_of(seen, cell), (seen.age_ms + allowance_ms) / 1000)
        case _:
            assert_never(view)


def _told(ask: Callable[[], T]) -> T | ImpactFault:
    """Answer of physics. Every failure in it is a fault, never a tier."""
    try:
        return ask()
    except RobotError as error:
        return ImpactFault(Reason.PHYSICS_FAULT, str(error.code))
    except SceneError as error:
        return ImpactFault(Reason.PERCEPTION_INVALID, error.detail)
    except UnprovenError as error:
        return ImpactFault(Reason.UNPROVEN, error.detail)
    except MotionError as error:
        return ImpactFault(error.reason, error.detail)
    except Exception as error:  # noqa: BLE001 - a narrower net would let something through
        return ImpactFault(Reason.PHYSICS_FAULT, type(error).__name__)


def scene_of(seen: Seen, cell: CellParameters) -> Scene:
    """Surveyed cell with all people and objects that any sensor sees; complete only where all sensors are.

    Raises:
        SceneError: a region or kind that is not in the declared sets.
    """
    return scene_observed((frame.observation for frame in seen.frames), cell, complete=seen.complete)


def _motion(request: Request, state: JointState, robot: Robot, cell: CellParameters) -> Motion | None:
    """Motion of a request from that state; None where physics knows none."""
    values = tuple(si(v.value, v.unit) for v in request.quantities)
    operation, here = operation_of(request.object, request.operation), state.q_rad
    moves = Moves.NOTHING if operation is None else operation.moves
    # Six joints, counted where they were read or bounded: hence the ignored argument types.
    match moves:
        case Moves.NOTHING | Moves.BY_FORCE | Moves.BY_HAND:  # `led_by` has the last two
            return None
        case Moves.TO_JOINTS:
            return MoveJ(here, values[:6], values[6], values[7])  # type: ignore[arg-type]
        case Moves.THROUGH_JOINTS:
            *points, speed, acceleration = values
            legs = tuple(JointLeg(point, speed, acceleration) for point in targets_of(operation, points))  # type: ignore[arg-type]
            return JointPath(here, legs)  # type: ignore[arg-type]
        case Moves.ALONG_TRAJECTORY:
            trajectory = trajectory_of(request)
            refuse_untimed(trajectory)
            refuse_elsewhere(trajectory, here)
            refuse_faster(request, trajectory)
            return trajectory
        case Moves.THROUGH_WAYPOINTS:
            return through_waypoints(request, here)  # type: ignore[arg-type]
        case Moves.TO_POSE:
            return MoveL(here, values[:6], values[6], values[7])  # type: ignore[arg-type]
        case Moves.AT_JOINT_SPEEDS:
            return stream_envelope(_stream(values, state), cell, under_way=not state.still)
        case Moves.AT_TOOL_SPEED:
            # A held tool speed lasts until it is ended; a late end has the patience of a stream of joint speeds.
            duration_s = values[7] + patience_s(cell.stop_deceleration_rad_s2)
            if any(values[:3]) and any(values[3:6]):
                # Its joints grow together, as they are written (LSD-29); its line has no course of its own (PHY-19).
                speeds = joint_speeds(robot, values[:6], here)  # type: ignore[arg-type]
                held = SpeedJ(here, speeds, values[6], AGAIN_S)  # type: ignore[arg-type]
                return stream_envelope(held, cell, under_way=False)
            return SpeedL(here, values[:6], values[6], duration_s)  # type: ignore[arg-type]
        case Moves.UNTIL_CONTACT:
            return contact_speed(here, values[:6], values[6], values[7])  # type: ignore[arg-type]
        case Moves.AFTER_JOINTS:
            return ServoJ(here, state.qd_rad_s, values[:6], values[6], values[7])  # type: ignore[arg-type]
        case Moves.AFTER_POSES:
            target = followed(robot, values[:6], here)  # type: ignore[arg-type]
            return ServoJ(here, state.qd_rad_s, target, values[6], values[7])  # type: ignore[arg-type]
        case Moves.FINGERS:
            return GripperMove(here, values[0], values[1], values[2])  # type: ignore[arg-type]
        case Moves.FINGERS_WHOLE:
            # Closed over the whole stroke at the fingers' highest speed. G1: FOR is 0 then, the least force.
            return GripperMove(here, 0.0, robot.tool.finger_speed_limit_m_s, robot.tool.force_min_n)  # type: ignore[arg-type]
        case Moves.OUTPUT:
            return OutputSet(request.quantities[0].value, bool(request.quantities[1].value))
        case Moves.STANDS:
            return MoveJ(here, here, 1.0, 1.0)  # type: ignore[arg-type]  # a move to where it is
        case _:
            assert_never(moves)


def _until_contact(request: Request) -> bool:
    operation = operation_of(request.object, request.operation)
    return operation is not None and operation.moves is Moves.UNTIL_CONTACT


def _stream(values: Sequence[float], state: JointState) -> SpeedJ:
    return SpeedJ(state.q_rad, values[:6], values[6], values[7])  # type: ignore[arg-type]


def _goes_on(request: Request, state: JointState) -> bool:
    """True where the request is for a stream, and the arm moves as that stream does."""
    operation = operation_of(request.object, request.operation)
    if operation is None or operation.moves is not Moves.AT_JOINT_SPEEDS:
        return False
    return moves_with(_stream([si(v.value, v.unit) for v in request.quantities], state), state.qd_rad_s)

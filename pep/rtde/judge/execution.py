"""Execution of a permitted command of a leased program: spend the permit, forward the command, watch the arm."""

from __future__ import annotations

import asyncio
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.values.units import Unit
from pep.base.errors import ActuationRefusedError, JournalError
from pep.base.operation_row import Moves, OperationKind
from pep.base.operations import touchable
from pep.base.request_digest import digest_of
from pep.gate.gate import EffectResult
from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import row_of
from pep.rtde.judge.command_requests import load_of
from pep.rtde.judge.lease_bounds import LeaseBounds
from pep.rtde.judge.pose_targets import rewritten
from pep.rtde.judge.stream_values import LeasedStream, StreamProgress, envelope
from pep.rtde.motion.motion_follower import ContactProgress, SettledProgress, TargetProgress, TimedProgress
from pep.rtde.motion.motions import finished
from pep.rtde.wire.client_texts import told
from pep.rtde.wire.refusal import InputRefusal
from pep.watch.watch import MotionOutcome
from pep.world.led_request import led_by
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capabilities.values.chain import Chain
    from capabilities.values.scope import Grant
    from pep.base.operation_row import Operation
    from pep.base.ports import Clock, RemainingImpact
    from pep.pit.assessment.led_motion import Led
    from pep.request.authority import Credentials
    from pep.request.permit import Permit
    from pep.rtde.command.command_values import Command
    from pep.rtde.command.gripper_commands import GripperCommand
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.judge.command_requests import CommandedOperation, ToolSetup
    from pep.rtde.judge.pose_targets import Posing
    from pep.rtde.judge.stream_values import Certifying
    from pep.rtde.motion.motion_follower import MotionProgress
    from pep.rtde.motion.motions import Motions
    from pep.rtde.robot.gripper import GripResult
    from pep.rtde.robot.judge_port import PendingCommand
    from pep.rtde.robot.newest_state import NewestState
    from pep.watch.watch import Watch
    from pep.world.held_object import DeclaredLoad
    from policies.evidence.model import Request
    from policies.words.parameters import Parameters

_PATHS: Final = (Moves.THROUGH_JOINTS, Moves.THROUGH_WAYPOINTS)
"""Motions that may rest on their way, also where they end, or where they began."""
BATCH_S: Final = 1.0
"""Time between two records of the digest of a stream's values."""


class AssessedMotions(Protocol):
    """Assessed motions, as the physics knows them: `pep.world.world.CellPhysics`."""

    def arrived(self, request_id: str, q_rad: tuple[float, ...]) -> bool:
        """True where an arm at these joint angles, rad, is at the target of that request."""
        ...

    def held_s(self, request_id: str) -> float:
        """Time for which the motion of that request may go on until a contact, s; 0 for any other."""
        ...


class WatchStarter(Protocol):
    """Begins the watch over what a permit allows."""

    def __call__(self, permit: Permit, *, remaining: RemainingImpact) -> Watch:
        """The watch; `remaining` judges what is left."""
        ...


class Recording(Protocol):
    """The gate's own record, for what belongs beside decisions."""

    async def __call__(self, kind: str, body: dict[str, object]) -> str:
        """The record's hash; raises `JournalError` when it cannot be made durable."""
        ...


class Fingers(Protocol):
    """Fingers of the robot's gripper."""

    async def grip(
        self, operation: Operation, numbers: Sequence[float], permit: Permit, *, begun: Callable[[], None]
    ) -> GripResult:
        """See `pep.rtde.own.tool_motions.ToolMotions.grip`."""
        ...


FINGERS: Final = frozenset({Moves.FINGERS, Moves.FINGERS_WHOLE})


@dataclass(eq=False, slots=True)
class ActiveCommand:
    """A command that is being decided, or carried out.

    Attributes:
        held: the command, as its line has it.
        command: the same, as it was given; no other one is answered.
        rewritten: what is asked about and sent in its place, the command itself for most ([LSD-14]).
        withdrawn: whether its program waits no longer.
        forwarded: whether it was sent.
        credentials: of the lease, by which it was decided last; None before.
        task: that decides it.
    """

    held: PendingCommand
    command: Command | IoCommand | GripperCommand
    rewritten: Command | IoCommand | GripperCommand | None = None
    withdrawn: bool = False
    forwarded: bool = False
    credentials: Credentials | None = None
    task: asyncio.Task[None] | None = None

    @property
    def renewed(self) -> bool:
        """True where another token has taken the place of the one by which it was decided last."""
        return self.credentials is not self.held.lease.credentials


@dataclass(frozen=True, slots=True)
class Prepared:
    """A stream that was shown a view, before it is decided."""

    grant: Grant
    certifying: Certifying


class LeasedEffects:
    """Carries out what was permitted. One at a time: the gate's slot sees to that.

    Args:
        motions: of the arm.
        acts: the physics that assessed them.
        remaining: the same, for what is left of a motion.
        certifying: begins a stream, with the objects that may be touched, and how a force or a hand leads it.
        posing: kinematics of the arm's model.
        declared: commits the load that a program has said it has.
        watching: begins a watch.
        fingers: of the gripper.
        record: for streams.
        parameters: of the policies.
        audience: canonical URL of the robot.
        clock: both clocks.
    """

    def __init__(
        self,
        *,
        motions: Motions,
        acts: AssessedMotions,
        remaining: RemainingImpact,
        certifying: Callable[[frozenset[str], Led | None], Certifying],
        posing: Posing,
        declared: Callable[[DeclaredLoad], None],
        watching: WatchStarter,
        fingers: Fingers,
        record: Recording,
        parameters: Parameters,
        audience: str,
        clock: Clock,
    ) -> None:
        self._motions = motions
        self._acts = acts
        self._remaining = remaining
        self._certifying = certifying
        self._posing = posing
        self._declared = declared
        self._watching = watching
        self._fingers = fingers
        self._record = record
        self._parameters = parameters
        self._audience = audience
        self._clock = clock
        self._looks = ThreadPoolExecutor(1, "shown")

    async def rewritten(self, command: Command | IoCommand) -> Command | IoCommand | InputRefusal:
        """Command that says its own target, from where the arm stands: [LSD-14]. On a thread of its own."""

        def ask() -> Command | IoCommand | InputRefusal:
            return rewritten(command, self._posing, self._motions.state.read().q_rad)  # type: ignore[arg-type]  # six

        return await asyncio.get_running_loop().run_in_executor(self._looks, ask)

    async def prepare(self, chain: Chain, request: Request) -> Prepared | InputRefusal | None:
        """A stream under that chain, shown the world as it is; None where the chain does not grant it.

        Args:
            chain: of the lease.
            request: that opens the stream. What holds for its values is on record from then on.
        """
        grant = chain.scope.find(request.object, request.operation)
        if grant is None:
            return None
        certifying = self._certifying(touchable(chain), led_by(request))

        def show() -> object:
            return certifying.see(self._motions.state.read().q_rad)

        shown = await asyncio.get_running_loop().run_in_executor(self._looks, show)
        if isinstance(shown, ImpactFault):
            return InputRefusal(Reason(shown.reason), shown.detail)
        try:
            await self._record("stream", envelope(request, chain, grant))
        except JournalError:
            return InputRefusal(Reason.RECORD_FAILED, "the envelope of the stream")
        return Prepared(grant, certifying)

    async def carry_out(
        self,
        case: ActiveCommand,
        asked: CommandedOperation,
        prepared: Prepared | None,
        fitted: ToolSetup,
        permit: Permit,
    ) -> EffectResult:
        """Forwards the command and follows its motion to the end: the effect of a gate's run.

        Args:
            case: the command; from when it was sent, it says so.
            asked: what its command is a request for.
            prepared: its stream, when it is one.
            fitted: as when it was asked for.
            permit: of exactly this.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the robot could not be read before; nothing was sent.
        """
        held = case.held
        if permit.request is None:
            raise ActuationRefusedError(Reason.NOT_WHAT_WAS_DECIDED, "no command of this permit")
        if asked.operation.moves in FINGERS:
            return await self._gripped(case, asked, permit)
        if asked.operation.kind is not OperationKind.MOTION:
            self._send(case, asked, permit, None)
            if (load := load_of(case.command, fitted)) is not None:
                self._declared(load)  # the model's arm carries it from now on, as the controller's does
            return EffectResult({"outcome": "sent"})
        arm = await self._motions.begins(permit)
        stream = self._begun(case, asked, prepared, fitted, permit=permit, arm=arm)
        watch = self._watching(permit, remaining=self._remaining if stream is None else stream)
        self._send(case, asked, permit, stream)
        arm.sent()
        loop = asyncio.get_running_loop()

        def brake(reason: Reason) -> None:
            loop.call_soon_threadsafe(held.stop, reason, told(reason))

        courses = (self._course(asked, permit.request, stream, held),)
        following = loop.create_task(self._motions.follow(courses, arm, watch, permit, brake=brake))
        try:
            while not following.done():
                await asyncio.wait((following,), timeout=BATCH_S)
                await self._kept(stream, held)
        finally:
            following.cancel()
            await finished(following)
        end = following.result()
        result = {"outcome": str(end.end), "q_rad": list(end.q_rad), "reason": end.reason}
        return EffectResult(result, failed=end.end is MotionOutcome.ROBOT_FAILED)

    async def _gripped(self, case: ActiveCommand, asked: CommandedOperation, permit: Permit) -> EffectResult:
        """Moves the fingers by the gateway's own line to the gripper; its program is answered once they may."""

        def begun() -> None:
            case.forwarded = case.held.forward()
            if not case.forwarded:
                raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "the program waits no longer")

        self._still_asked(case, permit)
        numbers = [each for each in asked.spelt if isinstance(each, float)]  # no lists: of the fingers
        grip = await self._fingers.grip(asked.operation, numbers, permit, begun=begun)
        result = {"outcome": str(grip.end), "width_um": grip.width_um, "object": grip.object, "reason": grip.reason}
        return EffectResult(result, failed=grip.end is MotionOutcome.ROBOT_FAILED)

    def _begun(
        self,
        case: ActiveCommand,
        asked: CommandedOperation,
        prepared: Prepared | None,
        fitted: ToolSetup,
        *,
        permit: Permit,
        arm: NewestState,
    ) -> LeasedStream | None:
        """Stream that the command opens, with its first value certified; None for any other command."""
        if not asked.stream:
            return None
        if prepared is None:
            raise ActuationRefusedError(Reason.NOT_GRANTED, "no stream was prepared")
        stream = LeasedStream(
            prepared.certifying,
            permit,
            bounds=LeaseBounds(asked.operation, prepared.grant, case.held.lease, case.credentials),
            parameters=self._parameters,
            posing=self._posing,
            fitted=fitted,
            arm=arm,
            stopper=self._motions.stopper,
            clock=self._clock,
        )
        reason = stream.step(case.held.command)  # type: ignore[arg-type]  # a stream's command is one of the control interface
        if reason is not None:
            raise ActuationRefusedError(reason, "the first value of the stream")
        return stream

    def _send(
        self, case: ActiveCommand, asked: CommandedOperation, permit: Permit, stream: LeasedStream | None
    ) -> None:
        """Spends the permit and sends the command. Both are on the event loop, and nothing comes in between."""
        self._still_asked(case, permit)
        digest = digest_of(asked.operation, asked.spelt, audience=self._audience)
        permit.spend(digest=digest, stopped_ms=self._motions.stopper.stopped_ms)
        # [LSD-14] what was judged, and not what the controller would make of the program's own command
        judged = case.rewritten if stream is None else stream.written(case.held.command)  # type: ignore[arg-type]  # as above
        # A mode that the script begins once has no values that follow; the watch ends it all the same.
        follows = isinstance(case.command, v.Command) and row_of(case.command).every_cycle
        steps = stream if follows else None
        case.forwarded = case.held.forward(steps, written=None if judged is case.command else judged)  # type: ignore[arg-type]
        if not case.forwarded:
            raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "the program waits no longer")

    def _still_asked(self, case: ActiveCommand, permit: Permit) -> None:
        """Refuses where the program waits no longer, or for something else, or with less authority than before."""
        if case.withdrawn:
            # A cancelled task may go on: what it waited for was there at the same moment.
            raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "the program waits no longer")
        if case.held.command != case.command:
            raise ActuationRefusedError(Reason.NOT_WHAT_WAS_DECIDED, "another command than was asked about")
        if case.renewed and (fault := permit.standing()) is not None:
            raise ActuationRefusedError(Reason(fault.code), "the lease's token is another one since, which has less")

    def _course(
        self, asked: CommandedOperation, request: Request, stream: LeasedStream | None, held: PendingCommand
    ) -> MotionProgress:
        if stream is not None:
            return StreamProgress(stream, self._clock)
        request_id = request.request_id
        if asked.operation.moves is Moves.UNTIL_CONTACT:
            lasts_ms = math.floor(self._acts.held_s(request_id) * Unit.MILLISECOND.per_si)
            timed = TimedProgress(self._clock.monotonic_ms() + lasts_ms, self._clock)
            return ContactProgress(timed, lambda: held.carried_out)
        progress = TargetProgress(lambda q_rad: self._acts.arrived(request_id, q_rad))
        return SettledProgress(progress, self._clock) if asked.operation.moves in _PATHS else progress

    async def _kept(self, stream: LeasedStream | None, held: PendingCommand) -> None:
        """Records the new values of the stream; without a record the stream is stopped."""
        batch = None if stream is None else stream.batch()
        if batch is None:
            return
        try:
            await self._record("stream-values", batch)
        except JournalError:
            held.stop(Reason.RECORD_FAILED, told(Reason.RECORD_FAILED))

    def close(self) -> None:
        """Ends its thread; nothing is carried out any more."""
        self._looks.shutdown(wait=False, cancel_futures=True)

"""Motions and switches of the cell's tools under their permits, one at a time by a slot.

permit ─▶ the arm stands where it was assessed ─▶ watch ─▶ permit spent, command written ─▶ followed to its end
"""

from __future__ import annotations

import asyncio
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.values.errors import QuantityError
from capabilities.values.units import Unit, parse
from pep.base.errors import ActuationRefusedError
from pep.base.operation_row import Moves
from pep.base.operations import JOINTS, SPEED_JOINT, targets_of
from pep.base.request_digest import digest_of
from pep.gate.motion_slot import Slot
from pep.pit.base.errors import MotionError
from pep.pit.path.timed_curve import curve_of
from pep.rtde.command import command_values as v
from pep.rtde.motion.brake import Brake
from pep.rtde.motion.governed_move import ARRIVED_RAD, SpeedControl, least_fraction
from pep.rtde.motion.motion_follower import HandOver, Over, TargetProgress, TimedProgress, TimeLimit
from pep.rtde.motion.motions import finished
from pep.rtde.motion.standstill import MotionEnd, Standstill
from pep.rtde.own.trajectory_stream import TargetWriter, TrajectoryProgress, target
from pep.watch.watch import PAUSE_S, Alarm, MotionOutcome
from pep.world.timed_request import request_of, trajectory_of
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Sequence

    from pep.base.operation_row import Operation
    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.motion.motion_follower import Looking, MotionProgress
    from pep.rtde.motion.motions import Motions
    from pep.rtde.own.tool_lease import OwnLines
    from pep.rtde.robot.digital_outputs import DigitalOutputs
    from pep.rtde.robot.gripper import GripResult
    from pep.rtde.robot.newest_state import NewestState
    from pep.rtde.robot.state_receiver import JointState
    from pep.watch.governor import Governor, ReportedSpeeds
    from policies.evidence.model import Request

EARLIER_PERIOD_MS: Final = 40
"""Time between checks of the authority of all earlier permits: well inside the 150 ms to a stop."""


class Gripper(Protocol):
    """Gripper, as the tools use it."""

    def move(self, *, width_um: int, speed_um_s: int, force_mn: int, stopped: Callable[[], bool]) -> GripResult:
        """Moves the fingers to their end; once `stopped` is true, they do not move."""
        ...

    def activate(self, *, stopped: Callable[[], bool]) -> GripResult:
        """Makes the gripper ready; once `stopped` is true, the fingers do not move."""
        ...

    def halt(self) -> None:
        """Stops the fingers in place."""
        ...


class GovernedWatchStarter(Protocol):
    """Begins the watch over what a permit allows."""

    def __call__(self, permit: Permit, *, governor: Governor | None = None) -> Looking:
        """The watch; with a governor the motion may be slowed down."""
        ...


class FingersProgress:
    """A move of the fingers, which the gripper follows by itself.

    Args:
        sending: its end.
    """

    stands: Final = True

    def __init__(self, sending: Future[GripResult]) -> None:
        self._sending = sending

    def look(self, state: JointState) -> Over | None:  # noqa: ARG002 - the port's own form
        """End as reached, once the gripper has ended the move."""
        return Over(MotionOutcome.REACHED) if self._sending.done() else None


class ProlongedWatch:
    """The watch over a stream of speeds: the newest permit's, and the authority of all before it.

    Args:
        permits: the one that began it, and those that prolong it, as they come.
        watching: begins a watch.
        clock: the monotonic one counts.
    """

    def __init__(self, permits: list[Permit], watching: GovernedWatchStarter, clock: Clock) -> None:
        self._permits = permits
        self._watching = watching
        self._clock = clock
        self._newest = permits[-1]
        self._watch = watching(self._newest)
        self._asked_ms = clock.monotonic_ms()

    def look(self, q_rad: tuple[float, ...], speeds: ReportedSpeeds | None = None) -> Alarm | None:
        """See `pep.watch.watch.Watch.look`."""
        if self._permits[-1] is not self._newest:
            self._newest = self._permits[-1]
            self._watch = self._watching(self._newest)
        return self._watch.look(q_rad, speeds) or self._earlier()

    def _earlier(self) -> Alarm | None:
        now_ms = self._clock.monotonic_ms()
        if now_ms - self._asked_ms < EARLIER_PERIOD_MS:
            return None
        self._asked_ms = now_ms
        for permit in self._permits[:-1]:
            fault = permit.standing()
            if fault is not None:
                lost = MotionOutcome.AUTHORITY_LOST
                return Alarm(lost, str(fault.code), now_ms, fault.clause, None, permit.index_milli)
        return None


@dataclass(slots=True)
class _Speeds:
    """A stream of joint speeds under way.

    Attributes:
        agent: whose it is.
        values: six speeds and the acceleration, as integers of their units.
        permits: the one that began it, and those that prolonged it.
        course: until when it lasts.
        ended: how it ended, for everybody who waits.
    """

    agent: str
    values: tuple[int, ...]
    permits: list[Permit]
    course: TimedProgress
    ended: asyncio.Future[MotionEnd]


class ToolMotions:
    """`pep.mcp.arm_server.ArmDriver` and the `MotionSlot` port. On one event loop.

    Args:
        lines: to the controller.
        motions: of the arm.
        gripper: of the robot.
        outputs: of the controller.
        watching: begins a watch.
        speed: slows a move down where that suffices; without it every such move is stopped.
        gripped: told how each grip has ended, before anything else is decided.
        audience: canonical URL of the server that decides.
        clock: both clocks.
    """

    def __init__(
        self,
        lines: OwnLines,
        motions: Motions,
        *,
        gripper: Gripper,
        outputs: DigitalOutputs,
        watching: GovernedWatchStarter,
        speed: SpeedControl | None,
        gripped: Callable[[GripResult], Awaitable[None]],
        audience: str,
        clock: Clock,
    ) -> None:
        self._lines = lines
        self._motions = motions
        self._gripper = gripper
        self._outputs = outputs
        self._watching = watching
        self._speed = speed
        self._gripped = gripped
        self._audience = audience
        self._clock = clock
        self._loop = asyncio.get_running_loop()
        self._slot = Slot()
        self._halt = Brake("stop fingers", gripper.halt)
        self._fingers = ThreadPoolExecutor(1, "gripper")
        self._reads = ThreadPoolExecutor(1, "state")
        self._speeds: _Speeds | None = None

    # -- one at a time

    def reserve(self, request_id: str) -> bool:
        """True when nothing acts and the slot is now this request's."""
        return self._slot.reserve(request_id)

    def release(self, request_id: str) -> None:
        """Frees the slot, if it was this request's."""
        self._slot.release(request_id)

    def joins(self, request: Request, *, agent: str) -> bool:
        """True for a request by that agent which only prolongs the stream that holds the slot."""
        speeds = self._speeds
        return (
            speeds is not None
            and agent != ""
            and (agent, SPEED_JOINT.object, SPEED_JOINT.name) == (speeds.agent, request.object, request.operation)
            and tuple(value.value for value in request.quantities[: len(speeds.values)]) == speeds.values
        )

    # -- acts

    async def act(
        self, operation: Operation, numbers: Sequence[float], permit: Permit
    ) -> MotionEnd | GripResult | None:
        """See `pep.mcp.arm_server.ArmDriver.act`; what is held after a move of the fingers is committed."""
        match operation.moves:
            case Moves.TO_JOINTS | Moves.THROUGH_JOINTS:
                return await self._move(operation, numbers, permit)
            case Moves.ALONG_TRAJECTORY:
                return await self._along(permit)
            case Moves.AT_JOINT_SPEEDS:
                return await self._at_speeds(numbers, permit)
            case Moves.FINGERS | Moves.FINGERS_WHOLE:
                return await self._grip(operation, numbers, permit, begun=_nothing, brake=self._brake)
            case Moves.OUTPUT:
                pin, value = numbers
                await self._outputs.set(int(pin), bool(value), permit)
                return None
            case _:
                raise ActuationRefusedError(Reason.NOT_GRANTED, f"no tool sends {operation.name}")

    def _spend(self, operation: Operation, numbers: Sequence[float], permit: Permit) -> None:
        """Spends the permit, the last check. The caller writes its command before it yields the event loop."""
        digest = digest_of(operation, tuple(numbers), audience=self._audience)
        permit.spend(digest=digest, stopped_ms=self._motions.stopper.stopped_ms)

    def _stopped(self, permit: Permit) -> bool:
        """True once a stop has come since the request of that permit."""
        stopped_ms = self._motions.stopper.stopped_ms
        return stopped_ms is not None and stopped_ms >= permit.since_ms

    async def _begins(self, permit: Permit) -> NewestState:
        """Arm that may begin: its control script waits for a command, and it stands where it was assessed."""
        if not await self._lines.ready():
            raise ActuationRefusedError(Reason.EFFECT_FAILED, "the controller does not take commands")
        return await self._motions.begins(permit)

    def _give(self, operation: Operation, numbers: Sequence[float], permit: Permit, command: v.Command) -> None:
        self._spend(operation, numbers, permit)
        if not self._lines.give(command):
            raise ActuationRefusedError(Reason.EFFECT_FAILED, "the controller did not take the command")

    async def _move(self, operation: Operation, numbers: Sequence[float], permit: Permit) -> MotionEnd:
        """Moves straight in joint space, at rest at each target.

        Legs are sent one by one: a path of the controller would need another program.
        """
        targets, (speed, acceleration) = targets_of(operation, tuple(numbers)), numbers[-2:]
        arm = await self._begins(permit)
        governor: Governor | None = None
        if self._speed is not None and operation.moves is Moves.TO_JOINTS:
            least = least_fraction(speed, acceleration)
            governor = self._speed.governor(arm, least=least, clock=self._clock)
        watch = self._watching(permit, governor=governor)
        commands = [v.MoveJ(_six(target), speed, acceleration, asynchronous=True) for target in targets]
        self._give(operation, numbers, permit, commands[0])
        arm.sent()
        legs = self._legs(commands, arm, permit, governor)
        return await self._motions.follow(legs, arm, watch, permit, brake=self._brake, governor=governor)

    def _legs(
        self, commands: list[v.MoveJ], arm: NewestState, permit: Permit, governor: Governor | None
    ) -> Iterator[MotionProgress]:
        """Progress of each leg, which begins once the controller has it. On the watch's thread."""
        start = arm.state.q_rad
        for leg, command in enumerate(commands):
            if leg:
                later = asyncio.run_coroutine_threadsafe(self._next(command, permit), self._loop)
                yield HandOver(later, lambda: self._stopped(permit))
                arm.sent()
            way = max(abs(b - a) for a, b in zip(start, command.q_rad, strict=True))
            lasts_ms = 1000 * (way / command.speed_rad_s + command.speed_rad_s / command.acceleration_rad_s2)
            yield TargetProgress(_near(command.q_rad), TimeLimit(lasts_ms, governor, self._clock).late)
            start = command.q_rad

    async def _next(self, command: v.MoveJ, permit: Permit) -> bool:
        """True once the next leg is written; False after a stop, or where the controller does not take it."""
        return await self._lines.ready() and not self._stopped(permit) and self._lines.give(command)

    async def _along(self, permit: Permit) -> MotionEnd:
        """Follows the decided trajectory: it is taken from the request, and no argument of the tool's counts."""
        if permit.request is None:
            raise ActuationRefusedError(Reason.NOT_WHAT_WAS_DECIDED, "no trajectory was decided")
        try:
            trajectory = trajectory_of(permit.request)
        except MotionError as error:
            raise ActuationRefusedError(Reason(error.reason), error.detail) from error
        speed, acceleration = permit.request.quantities
        arm = await self._begins(permit)
        watch = self._watching(permit)
        curve = curve_of(trajectory)
        sent = request_of(trajectory, speed=speed, acceleration=acceleration, audience=self._audience)
        permit.spend(digest=sent.digest, stopped_ms=self._motions.stopper.stopped_ms)
        if not self._lines.give(target(curve.q[0])):
            raise ActuationRefusedError(Reason.EFFECT_FAILED, "the controller did not take the command")
        arm.sent()
        writer = TargetWriter(curve, self._lines, self._loop.time)
        writing = asyncio.ensure_future(writer.write())
        course = TrajectoryProgress(curve, writer, self._clock)
        try:
            return await self._motions.follow((course,), arm, watch, permit, brake=self._brake)
        finally:
            writing.cancel()

    async def _at_speeds(self, numbers: Sequence[float], permit: Permit) -> MotionEnd:
        """Moves at joint speeds for a time. A call that prolongs the stream waits for its end too."""
        try:
            values = tuple(parse(n, p.unit) for n, p in zip(numbers, SPEED_JOINT.parameters, strict=True))
        except (QuantityError, ValueError) as error:
            raise ActuationRefusedError(Reason.NOT_WHAT_WAS_DECIDED, "no speeds") from error
        lasts_ms, speeds = values[-1], self._speeds
        if speeds is None:
            return await self._begin_speeds(numbers, values[:-1], lasts_ms, permit)
        if permit.agent != speeds.agent or values[:-1] != speeds.values:
            raise ActuationRefusedError(Reason.BUSY, "another stream is under way")
        self._spend(SPEED_JOINT, numbers, permit)
        if not speeds.course.prolong(permit.since_ms + lasts_ms):
            raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "the stream that it would have prolonged has ended")
        speeds.permits.append(permit)
        try:
            return await asyncio.shield(speeds.ended)
        except asyncio.CancelledError:
            self._brake(Reason.VERDICT_EXPIRED)
            await finished(speeds.ended)
            raise

    async def _begin_speeds(
        self, numbers: Sequence[float], values: tuple[int, ...], lasts_ms: int, permit: Permit
    ) -> MotionEnd:
        if not self.reserve(permit.request_id):
            raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "the stream that it would have prolonged has ended")
        arm = await self._begins(permit)
        permits = [permit]
        watch = ProlongedWatch(permits, self._watching, self._clock)
        until_ms = self._clock.monotonic_ms() + lasts_ms
        course, ended = TimedProgress(until_ms, self._clock), self._loop.create_future()
        self._give(SPEED_JOINT, numbers, permit, v.SpeedJ(_six(numbers[:JOINTS]), numbers[JOINTS], 0.0))
        arm.sent()
        self._speeds = _Speeds(permit.agent, values, permits, course, ended)
        end = MotionEnd(MotionOutcome.ROBOT_FAILED, ())
        try:
            end = await self._motions.follow((course,), arm, watch, permit, brake=self._brake)
        finally:
            self._speeds = None
            for each in permits:
                each.watched = permit.watched
            ended.set_result(end)
        return end

    async def grip(
        self, operation: Operation, numbers: Sequence[float], permit: Permit, *, begun: Callable[[], None]
    ) -> GripResult:
        """Moves the fingers for a leased program; what is held afterwards is committed.

        Args:
            operation: `gripper_move` or `gripper_activate`.
            numbers: its parameters in order, in SI units.
            permit: of exactly these numbers.
            begun: is called once the permit is spent, before anything is sent; what it raises keeps the fingers still.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the gripper cannot be reached, or is not ready.
        """
        return await self._grip(operation, numbers, permit, begun=begun, brake=self._halted)

    async def _grip(
        self,
        operation: Operation,
        numbers: Sequence[float],
        permit: Permit,
        *,
        begun: Callable[[], None],
        brake: Callable[[Reason], None],
    ) -> GripResult:
        """Moves the fingers, by a connection of their own; the resting arm's angles place them."""
        arm = await self._motions.heard()
        watch = self._watching(permit)
        self._spend(operation, numbers, permit)
        begun()
        sending = self._fingers.submit(self._send_fingers, operation, tuple(numbers), permit)
        end = await self._motions.follow((FingersProgress(sending),), arm, watch, permit, brake=brake)
        try:
            grip = await asyncio.wrap_future(sending)
        except BaseException:
            await self.stop()  # what was handed over and not acknowledged may yet begin
            raise
        if end.end not in (MotionOutcome.REACHED, MotionOutcome.STOPPED):
            grip = replace(grip, end=end.end, reason=end.reason)
        elif not grip.arrived:
            grip = replace(grip, end=MotionOutcome.STOPPED if self._stopped(permit) else MotionOutcome.ROBOT_FAILED)
        await self._gripped(grip)
        return grip

    def _send_fingers(self, operation: Operation, numbers: tuple[float, ...], permit: Permit) -> GripResult:
        def stopped() -> bool:
            return self._stopped(permit)

        if stopped():
            permit.refusal = Reason.VERDICT_EXPIRED
            raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "a stop came before it was sent")
        if operation.moves is Moves.FINGERS_WHOLE:
            return self._gripper.activate(stopped=stopped)
        width_m, speed_m_s, force_n = numbers
        width, speed = parse(width_m, Unit.MICROMETRE), parse(speed_m_s, Unit.MICROMETRE_PER_SECOND)
        return self._gripper.move(
            width_um=width, speed_um_s=speed, force_mn=parse(force_n, Unit.MILLINEWTON), stopped=stopped
        )

    # -- stopping

    def _brake(self, reason: Reason) -> None:  # noqa: ARG002 - the outcome on record tells it
        """Begins to stop arm and fingers; earlier requests are void. From any thread; never waits."""
        self._lines.stop()
        self._halt.take()

    def _halted(self, reason: Reason) -> None:  # noqa: ARG002 - likewise
        """Begins to stop the fingers. From any thread; never waits."""
        self._halt.take()

    async def stop(self) -> MotionEnd:
        """Stops arm and fingers, and waits for the standstill. No earlier request moves them any more."""
        escalate = self._motions.stopper.stop
        stop = Standstill(
            lambda: escalate(Reason.VERDICT_EXPIRED), newest=self._motions.state.newest, clock=self._clock
        )
        self._brake(Reason.VERDICT_EXPIRED)
        while (end := stop.look()) is None:  # noqa: ASYNC110 - the arm itself sets no event
            await asyncio.sleep(PAUSE_S)
        return end

    # -- looking

    async def read_state(self) -> JointState:
        """State of the robot now.

        Raises:
            RobotError: the robot says nothing.
        """
        return await self._loop.run_in_executor(self._reads, self._motions.state.read)

    async def close(self) -> None:
        """Stops arm and fingers; nothing can be sent any more."""
        await finished(asyncio.ensure_future(self.stop()))
        self._lines.end()
        for pool in (self._fingers, self._reads):
            pool.shutdown(wait=False, cancel_futures=True)
        self._outputs.close()


def _nothing() -> None:
    """Does nothing: nobody waits for the beginning."""


def _near(target: v.Six) -> Callable[[tuple[float, ...]], bool]:
    return lambda q_rad: all(abs(x - y) <= ARRIVED_RAD for x, y in zip(q_rad, target, strict=True))


def _six(numbers: Sequence[float]) -> v.Six:
    a, b, c, d, e, f = map(float, numbers)
    return a, b, c, d, e, f

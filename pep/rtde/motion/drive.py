"""Driving the arm and gripper of one cell: a motion is sent once, watched to its end, stopped at any time.

What moves is looked at from a thread of its own, which also stops it: neither the event loop with its callers, nor
whoever reads the state, nor a command that is being handed over can delay a look or a stop.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values.units import Unit, parse
from pep.base.errors import ActuationRefusedError, PepFault
from pep.base.operations import GRIPPER_ACTIVATE, GRIPPER_MOVE, digest_of
from pep.base.stop_model import SAFE_MODES
from pep.gate.motion_slot import Slot
from pep.rtde.motion.governed_move import ARRIVED_RAD, SpeedControl, least_fraction, put_back
from pep.rtde.motion.stop_ladder import STOP_LIMIT_MS, MotionEnd, StopLadder
from pep.rtde.robot.newest_state import SILENCE_MS, NewestState
from pep.watch.governor import FULL
from pep.watch.watch import PAUSE_S, MotionOutcome
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.motion.drive_ports import GovernedWatchStarter, Gripper, Hurry
    from pep.rtde.motion.permitted_control import PermittedControl
    from pep.rtde.robot.gripper import GripResult
    from pep.rtde.robot.state_receiver import JointState, RobotState
    from pep.watch.governor import Governor
    from pep.watch.watch import Alarm

__all__ = ["Drive", "MotionEnd", "MotionOutcome"]

STARTS_MS: Final = 1_000
"""A motion that has not begun by then will not begin."""
SLACK: Final = 1.5
SLACK_MS: Final = 3_000
"""A motion may last its computed time by half, and three seconds; then it is stopped. Time slowed down counts less."""

T = TypeVar("T")


class Drive:
    """The one way to the arm and the gripper; also the `MotionSlot` port.

    Args:
        control: guarded.
        state: what the robot says about itself.
        gripper: of the robot.
        dashboard_stop: the last rung of the stop ladder.
        start_of: joint angles from which a request was assessed.
        watching: begins the watch over what a permit allows.
        hurry: told whether something moves, so that what the watch goes by comes sooner.
        speed: slows a move down where that suffices; without it every such move is stopped.
        audience: canonical URL of the server that decides.
        clock: both clocks.

    Attributes:
        watching: as given; other motions of the same arm are watched likewise.
    """

    def __init__(
        self,
        *,
        control: PermittedControl,
        state: RobotState,
        gripper: Gripper,
        dashboard_stop: Callable[[], None],
        start_of: Callable[[str], tuple[float, ...] | None],
        watching: GovernedWatchStarter,
        hurry: Hurry,
        audience: str,
        clock: Clock,
        speed: SpeedControl | None = None,
    ) -> None:
        self._control = control
        self._state = state
        self._gripper = gripper
        self._start_of = start_of
        self.watching = watching
        self._hurry = hurry
        self._speed = speed
        self._audience = audience
        self._clock = clock
        self._ladder = StopLadder(
            control=control, halt=gripper.halt, dashboard_stop=dashboard_stop, newest=state.newest, clock=clock
        )
        self._slot = Slot()
        self._watch = ThreadPoolExecutor(1, "watch")
        self._commands = ThreadPoolExecutor(1, "command")
        self._fingers = ThreadPoolExecutor(1, "gripper")
        self._reads = ThreadPoolExecutor(1, "state")

    # -- one at a time

    def reserve(self, request_id: str) -> bool:
        """True when nothing moves and the arm is now this request's."""
        return self._slot.reserve(request_id)

    def release(self, request_id: str) -> None:
        """The arm is free again, if it was this request's."""
        self._slot.release(request_id)

    # -- motion

    async def move_joint(
        self, q_rad: Sequence[float], speed_rad_s: float, acceleration_rad_s2: float, permit: Permit
    ) -> MotionEnd:
        """The arm has moved, or why it has not.

        Args:
            q_rad: target, 6 angles.
            speed_rad_s: of the leading axis.
            acceleration_rad_s2: of the leading axis.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the robot could not be read before sending; nothing was sent.
        """
        target = tuple(q_rad)

        def send() -> bool:
            return self._control.moveJ(target, speed_rad_s, acceleration_rad_s2, True, permit=permit)  # noqa: FBT003

        return await self._move((target,), speed_rad_s, acceleration_rad_s2, permit, send, governed=True)

    async def move_path(
        self, waypoints_rad: Sequence[Sequence[float]], speed_rad_s: float, acceleration_rad_s2: float, permit: Permit
    ) -> MotionEnd:
        """The arm has moved through the waypoints, at rest at each, or why it has not. One watch looks at all of it.

        Args:
            waypoints_rad: 1 to 4 targets, 6 angles each.
            speed_rad_s: of the leading axis of each leg.
            acceleration_rad_s2: likewise.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the robot could not be read before sending; nothing was sent.
        """
        targets = tuple(tuple(point) for point in waypoints_rad)

        def send() -> bool:
            return self._control.move_path(targets, speed_rad_s, acceleration_rad_s2, permit=permit)

        return await self._move(targets, speed_rad_s, acceleration_rad_s2, permit, send, governed=False)

    async def _move(
        self,
        targets: tuple[tuple[float, ...], ...],
        speed_rad_s: float,
        acceleration_rad_s2: float,
        permit: Permit,
        send_first: Callable[[], bool],
        *,
        governed: bool,
    ) -> MotionEnd:
        def first() -> tuple[float, ...]:
            start = self._state.read()
            permit.begins(assessed_rad=self._start_of(permit.request_id), at_rad=start.q_rad)
            send_first()
            return start.q_rad

        def send(leg: int) -> int:
            """How long that leg may last, in ms, now that it was sent; 0 when it was not."""
            if leg == 0:
                start = first()
            elif self._control.next_leg():
                start = targets[leg - 1]
            else:
                return 0
            way = max((abs(b - a) for a, b in zip(start, targets[leg], strict=True)), default=0.0)
            lasts_ms = 1000 * (way / speed_rad_s + speed_rad_s / acceleration_rad_s2)
            return int(lasts_ms * SLACK) + SLACK_MS

        least = least_fraction(speed_rad_s, acceleration_rad_s2) if governed else None
        return await self.watched(lambda gone: self._paced(targets, send, permit, gone, least=least), permit)

    def _paced(
        self,
        targets: tuple[tuple[float, ...], ...],
        send: Callable[[int], int],
        permit: Permit,
        gone: threading.Event,
        *,
        least: float | None,
    ) -> MotionEnd:
        """The move followed to its end, its speed governed, and the speed slider back where it was."""
        arm = NewestState(self._state, self._clock)
        governor: Governor | None = None
        if self._speed is not None and least is not None:
            governor = self._speed.governor(arm, least=least, clock=self._clock)
        end: MotionEnd | None = None
        try:
            end = self._follow(targets, send, permit, gone, arm=arm, governor=governor)
        finally:
            if governor is not None and governor.changes:
                if end is None:
                    self.stand()  # before it may be faster again
                put_back(governor, arm, clock=self._clock)
                watched = permit.watched or {"outcome": str(end.end) if end is not None else None}
                permit.watched = {**watched, "speed": [change.told() for change in governor.changes]}
        return end if governor is None else replace(end, changes=tuple(governor.changes))

    def _follow(
        self,
        targets: tuple[tuple[float, ...], ...],
        send: Callable[[int], int],
        permit: Permit,
        gone: threading.Event,
        *,
        arm: NewestState,
        governor: Governor | None,
    ) -> MotionEnd:
        """Look at the arm until it has arrived or stands still for another reason. On the watch's thread."""
        sending = self._commands.submit(send, 0)
        watch = self.watching(permit, governor=governor)
        leg, looked_ms, lasted_ms, limit_ms, moved = 0, 0, 0.0, 0, False
        while True:
            if limit_ms == 0 and sending.done():
                limit_ms = sending.result()
                if limit_ms == 0:
                    return self._not_sent(permit)
                looked_ms, lasted_ms = arm.sent(), 0.0
            fresh = arm.look()
            moved = moved or not arm.state.still
            alarm = watch.look(arm.state.q_rad, arm.speeds)
            if gone.is_set():
                return self.stand(sending)
            if alarm is not None:
                return self.end_by(alarm, permit, arm.state, sending)
            if arm.silent_ms > SILENCE_MS:
                self.stand(sending)
                return MotionEnd(MotionOutcome.ROBOT_FAILED, (), str(PepFault.ROBOT_STALLED))
            # Only what the robot said after it was told to move can say how that went.
            if limit_ms and fresh:
                now = self._clock.monotonic_ms()
                lasted_ms += (now - looked_ms) * (FULL if governor is None else governor.ordered)
                looked_ms = now
                end = self._judge(arm.state, targets[leg], permit, lasted_ms=lasted_ms, limit_ms=limit_ms, moved=moved)
                if end is not None and (end.end is not MotionOutcome.REACHED or leg + 1 == len(targets)):
                    return end
                if end is not None:
                    leg, limit_ms, moved = leg + 1, 0, False
                    sending = self._commands.submit(send, leg)
            time.sleep(PAUSE_S)

    def _not_sent(self, permit: Permit) -> MotionEnd:
        """A later leg of a path was not sent: after a stop, or the controller did not take it."""
        stopped = self._stopped(permit)
        end = self.stand()
        return end if stopped else MotionEnd(MotionOutcome.ROBOT_FAILED, end.q_rad, "a leg was not taken")

    def _stopped(self, permit: Permit) -> bool:
        stopped_ms = self._control.stopped_ms
        return stopped_ms is not None and stopped_ms >= permit.since_ms

    def _judge(
        self,
        state: JointState,
        target: tuple[float, ...],
        permit: Permit,
        *,
        lasted_ms: float,
        limit_ms: int,
        moved: bool,
    ) -> MotionEnd | None:
        """How the motion has ended, by the robot's own word; None while it goes on. Times are those of full speed."""
        if state.still and _near(state.q_rad, target, ARRIVED_RAD):
            return MotionEnd(MotionOutcome.REACHED, state.q_rad)
        if state.still and self._stopped(permit):
            return MotionEnd(MotionOutcome.STOPPED, state.q_rad)
        if state.still and (lasted_ms > STARTS_MS or state.safety_mode not in SAFE_MODES):
            # Whatever the controller still has in mind, it is not begun later behind our back.
            end = self.stand()
            return MotionEnd(MotionOutcome.ROBOT_FAILED, end.q_rad, f"safety mode {state.safety_mode}, moved {moved}")
        if lasted_ms > limit_ms:
            return MotionEnd(MotionOutcome.ROBOT_FAILED, self.stand().q_rad, "too slow")
        return None

    async def gripper_move(self, width_m: float, speed_m_s: float, force_n: float, permit: Permit) -> GripResult:
        """The fingers have moved, or why they have not.

        Args:
            width_m: opening asked for.
            speed_m_s: of the fingers.
            force_n: of the grip.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the gripper does not answer, or the robot could not be read before sending.
        """

        def move(stopped: Callable[[], bool]) -> GripResult:
            width, speed = parse(width_m, Unit.MICROMETRE), parse(speed_m_s, Unit.MICROMETRE_PER_SECOND)
            force = parse(force_n, Unit.MILLINEWTON)
            return self._gripper.move(width_um=width, speed_um_s=speed, force_mn=force, stopped=stopped)

        digest = digest_of(GRIPPER_MOVE, (width_m, speed_m_s, force_n), audience=self._audience)
        return await self._with_fingers(move, digest, permit)

    async def gripper_activate(self, permit: Permit) -> GripResult:
        """The gripper is ready, or why it is not; its fingers have closed and opened once.

        Args:
            permit: of exactly this.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the gripper does not answer, or does not become ready.
        """
        digest = digest_of(GRIPPER_ACTIVATE, (), audience=self._audience)
        return await self._with_fingers(lambda stopped: self._gripper.activate(stopped=stopped), digest, permit)

    async def _with_fingers(
        self, act: Callable[[Callable[[], bool]], GripResult], digest: str, permit: Permit
    ) -> GripResult:
        # Counted before the permit is spent: a stop before that voids the permit, and one after it changes the count.
        stops = self._control.stops
        permit.spend(digest=digest, stopped_ms=self._control.stopped_ms)

        def stopped() -> bool:
            return self._control.stops != stops

        def send() -> GripResult:
            if stopped():
                permit.refusal = Reason.VERDICT_EXPIRED
                raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "a stop came before it was sent")
            return act(stopped)

        grip = await self.watched(lambda gone: self._follow_fingers(send, permit, gone), permit)
        if grip.end is not MotionOutcome.REACHED or grip.arrived:
            return grip
        return replace(grip, end=MotionOutcome.STOPPED if stopped() else MotionOutcome.ROBOT_FAILED)

    def _follow_fingers(self, send: Callable[[], GripResult], permit: Permit, gone: threading.Event) -> GripResult:
        """Watch until the fingers have moved. On the watch's thread; the resting arm's angles place the fingers."""
        arm = NewestState(self._state, self._clock)
        sending = self._fingers.submit(send)
        watch = self.watching(permit)
        alarm: Alarm | None = None
        while not sending.done() and alarm is None and not gone.is_set():
            arm.look()
            alarm = watch.look(arm.state.q_rad)
            wait((sending,), timeout=PAUSE_S)
        if alarm is not None:
            end = self.end_by(alarm, permit, arm.state, sending)
            return replace(sending.result(), end=end.end, reason=end.reason)
        if gone.is_set():
            self.stand()
        return sending.result()

    # -- stopping

    async def stop(self) -> MotionEnd:
        """The arm stands still, and the fingers; nothing that was asked for before will move them any more.

        The command goes out at once. If the arm still moves 0.7 s later, or the command cannot be given, the dashboard
        ends the program.
        """
        stop = self._ladder.begin()
        while (end := stop.look()) is None:  # noqa: ASYNC110 - the arm itself sets no event
            await asyncio.sleep(PAUSE_S)
        return end

    def stand(self, sending: Future[T] | None = None) -> MotionEnd:
        """The same, for the watch's thread.

        Args:
            sending: a command that may still be being handed over. Standstill counts once that has ended, too.
        """
        stop = self._ladder.begin()
        while (end := stop.look()) is None:
            time.sleep(PAUSE_S)
        if sending is None or sending.done():
            return end
        wait((sending,), timeout=STOP_LIMIT_MS / 1000)
        return self.stand()

    def end_by(self, alarm: Alarm, permit: Permit, state: JointState, sending: Future[T] | None = None) -> MotionEnd:
        """The motion has ended because of an alarm, and the permit tells its record what was seen.

        Args:
            alarm: why.
            permit: of the motion.
            state: where the arm was when it was seen.
            sending: as for `stand`.
        """
        end = self.stand(sending)
        stood = end.q_rad if end.end is MotionOutcome.STOPPED else None
        permit.watched = alarm.told(at_rad=state.q_rad, stood_rad=stood)
        return MotionEnd(alarm.end, end.q_rad, alarm.reason) if end.end is MotionOutcome.STOPPED else end

    async def watched(self, follow: Callable[[threading.Event], T], permit: Permit) -> T:
        """What `follow` says on the watch's thread; neither a caller that goes away nor an error leaves it moving."""
        gone = threading.Event()

        def guarded() -> T:
            try:
                return follow(gone)
            except BaseException:
                # Also a command that was handed over and not acknowledged: it may yet begin.
                if permit.spent:
                    self.stand()
                raise

        self._hurry(moving=True)
        following = asyncio.get_running_loop().run_in_executor(self._watch, guarded)
        try:
            return await asyncio.shield(following)
        except asyncio.CancelledError:
            # An arm without anybody who waits for it stands still.
            if not following.done():
                gone.set()
                await self.stop_although_cancelled()
                await self._finish(following)
            raise
        finally:
            self._hurry(moving=False)

    async def stop_although_cancelled(self) -> None:
        """As `stop`, also when the task that asks is being cancelled."""
        await self._finish(asyncio.ensure_future(self.stop()))

    async def _finish(self, ending: asyncio.Future[T]) -> None:
        """It has ended, also when the task that asks is being cancelled; how is for somebody else."""
        while not ending.done():
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await asyncio.shield(ending)
        if not ending.cancelled():
            ending.exception()

    # -- looking

    def heard(self) -> NewestState:
        """What the robot has said last, from now on.

        Raises:
            RobotError: it says nothing.
        """
        return NewestState(self._state, self._clock)

    async def read_state(self) -> JointState:
        """The robot's state now.

        Raises:
            RobotError: when it says nothing.
        """
        return await asyncio.get_running_loop().run_in_executor(self._reads, self._state.read)

    async def close(self) -> None:
        """The arm stands still, its program has ended, and nothing can be sent any more."""
        await self._finish(asyncio.ensure_future(self.stop()))
        loop = asyncio.get_running_loop()
        ends = ThreadPoolExecutor(2, "close")
        watched = (self._watch, lambda: None)  # the watch over what has just been stopped has ended, too
        for pool, end in (watched, (ends, self._control.stopScript), (ends, self._control.disconnect)):
            try:
                await asyncio.wait_for(loop.run_in_executor(pool, end), STOP_LIMIT_MS / 1000)
            except Exception:  # noqa: BLE001, S112 - the arm stands; what is left is tidying
                continue
        for pool in (self._watch, self._commands, self._fingers, self._reads, ends):
            pool.shutdown(wait=False, cancel_futures=True)


def _near(a: Sequence[float], b: Sequence[float], tolerance_rad: float) -> bool:
    return len(a) == len(b) and all(abs(x - y) <= tolerance_rad for x, y in zip(a, b, strict=True))

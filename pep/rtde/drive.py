"""Driving the arm and gripper of one cell: a motion is sent once, watched to its end, stopped at any time.

Four workers, so that nothing waits for what it must not wait for: commands, reading, the gripper, and stops, which wait
for nobody.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.units import Unit, parse
from pep.errors import ActuationRefusedError, RobotError
from pep.operations import GRIPPER_MOVE, digest_of
from policies.reasons import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.permit import Permit
    from pep.ports import Clock
    from pep.rtde.gripper import Grip
    from pep.rtde.guard import GuardedControl
    from pep.rtde.state import JointState, RobotState

ARRIVED_RAD: Final = 1e-3
"""A joint this near to its target has arrived; the controller holds about a tenth of it."""
START_TOLERANCE_RAD: Final = 2e-3
"""The arm may differ this much from where the assessment began."""
POLL_S: Final = 0.008
"""Pause between two looks at a moving arm: four packages of the controller."""
STANDING_PERIOD_MS: Final = 40
"""How often the authority behind a motion is looked at again: well inside 150 ms."""
STARTS_MS: Final = 1_000
"""A motion that has not begun by then will not begin."""
SILENCE_MS: Final = 300
"""A moving arm that says nothing for this long is stopped."""
SLACK: Final = 1.5
SLACK_MS: Final = 3_000
"""A motion may last its computed time by half, and three seconds; then it is stopped."""
ESCALATE_MS: Final = 700
"""An arm that still moves then is stopped by the dashboard too: pi rad/s at 8 rad/s2 takes 0.4 s, and 0.06 s to begin.

A cell with a weaker stop model may get both stops; the second does no harm."""
STOP_LIMIT_MS: Final = 5_000
SAFE_MODES: Final = (1, 2)  # safety_mode NORMAL and REDUCED; any other has stopped the arm by itself


class End(StrEnum):
    """How a motion ended."""

    REACHED = "reached"
    STOPPED = "stopped"
    """By a stop."""
    AUTHORITY_LOST = "authority_lost"
    """Stopped because the token was revoked, ran out, or the revocation view grew too old."""
    ROBOT_FAILED = "robot_failed"
    """The arm did not move, stopped by itself, cannot be read, or took too long."""


@dataclass(frozen=True, slots=True)
class MotionEnd:
    """The end of a motion: how, where, and why if it was cut short."""

    end: End
    q_rad: tuple[float, ...]
    reason: str = ""


class Gripper(Protocol):
    """What the drive needs of a gripper."""

    def move(self, *, width_um: int, speed_um_s: int, force_mn: int, stopped: Callable[[], bool]) -> Grip:
        """The fingers have moved; from when `stopped` says so, they do not move."""
        ...

    def halt(self) -> None:
        """The fingers stop where they are."""
        ...


class Drive:
    """The one way to the arm and the gripper; also the `MotionSlot` port.

    Args:
        control: guarded.
        state: what the robot says about itself.
        gripper: of the robot.
        dashboard_stop: the last rung of the stop ladder.
        start_of: joint angles from which a request was assessed.
        audience: canonical URL of the server that decides.
        clock: both clocks.
    """

    def __init__(
        self,
        *,
        control: GuardedControl,
        state: RobotState,
        gripper: Gripper,
        dashboard_stop: Callable[[], None],
        start_of: Callable[[str], tuple[float, ...] | None],
        audience: str,
        clock: Clock,
    ) -> None:
        self._control = control
        self._state = state
        self._gripper = gripper
        self._dashboard_stop = dashboard_stop
        self._start_of = start_of
        self._audience = audience
        self._clock = clock
        self._holder: str | None = None
        self._commands = ThreadPoolExecutor(1, "command")
        self._reads = ThreadPoolExecutor(1, "state")
        self._fingers = ThreadPoolExecutor(1, "gripper")
        self._stops = ThreadPoolExecutor(4, "stop")
        self._stopping: asyncio.Future[None] | None = None

    # -- one at a time

    def reserve(self, request_id: str) -> bool:
        """True when nothing moves and the arm is now this request's."""
        if self._holder is None:
            self._holder = request_id
        return self._holder == request_id

    def release(self, request_id: str) -> None:
        """The arm is free again, if it was this request's."""
        if self._holder == request_id:
            self._holder = None

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
        loop = asyncio.get_running_loop()
        target = tuple(q_rad)

        def send() -> JointState:
            start = self._state.read()
            assessed = self._start_of(permit.request_id)
            if assessed is None or not _near(start.q_rad, assessed, START_TOLERANCE_RAD):
                permit.refusal = Reason.NOT_WHAT_WAS_DECIDED
                raise ActuationRefusedError(Reason.NOT_WHAT_WAS_DECIDED, "the arm is not where the assessment began")
            self._control.moveJ(target, speed_rad_s, acceleration_rad_s2, True, permit=permit)  # noqa: FBT003
            return start

        try:
            start = await loop.run_in_executor(self._commands, send)
            way = max((abs(b - a) for a, b in zip(start.q_rad, target, strict=True)), default=0.0)
            lasts_ms = 1000 * (way / speed_rad_s + speed_rad_s / acceleration_rad_s2)
            return await self._follow(target, permit, limit_ms=int(lasts_ms * SLACK) + SLACK_MS)
        except asyncio.CancelledError:
            # The caller has gone; an arm without anybody who waits for it stands still.
            await self._finish_stopping()
            raise
        except Exception:
            # Handed over and not acknowledged: it may yet begin.
            if permit.spent:
                await self._finish_stopping()
            raise

    async def _follow(self, target: tuple[float, ...], permit: Permit, *, limit_ms: int) -> MotionEnd:
        """Look at the arm until it has arrived or stands still for another reason."""
        sent_ms = looked_ms = heard_ms = self._clock.monotonic_ms()
        moved = False
        while True:
            try:
                state = await self._read()
            except RobotError as error:
                if self._clock.monotonic_ms() - heard_ms <= SILENCE_MS:
                    continue
                await self._finish_stopping()
                return MotionEnd(End.ROBOT_FAILED, (), str(error.code))
            now = heard_ms = self._clock.monotonic_ms()
            stopped = self._control.stopped_ms is not None and self._control.stopped_ms >= permit.since_ms
            moved = moved or not state.still
            if state.still and _near(state.q_rad, target, ARRIVED_RAD):
                return MotionEnd(End.REACHED, state.q_rad)
            if state.still and stopped:
                return MotionEnd(End.STOPPED, state.q_rad)
            if state.still and (now - sent_ms > STARTS_MS or state.safety_mode not in SAFE_MODES):
                # Whatever the controller still has in mind, it is not begun later behind our back.
                end = await self.stop()
                return MotionEnd(End.ROBOT_FAILED, end.q_rad, f"safety mode {state.safety_mode}, moved {moved}")
            if now - looked_ms >= STANDING_PERIOD_MS:
                looked_ms = now
                fault = permit.standing()
                if fault is not None:
                    end = await self.stop()
                    return MotionEnd(End.AUTHORITY_LOST, end.q_rad, str(fault.code))
            if now - sent_ms > limit_ms:
                end = await self.stop()
                return MotionEnd(End.ROBOT_FAILED, end.q_rad, "too slow")
            await asyncio.sleep(POLL_S)

    async def gripper_move(self, width_m: float, speed_m_s: float, force_n: float, permit: Permit) -> Grip:
        """The fingers have moved, or why they have not.

        Args:
            width_m: opening asked for.
            speed_m_s: of the fingers.
            force_n: of the grip.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the gripper does not answer.
        """
        # Counted before the permit is spent: a stop before that voids the permit, and one after it changes the count.
        stops = self._control.stops
        permit.spend(
            digest=digest_of(GRIPPER_MOVE, (width_m, speed_m_s, force_n), audience=self._audience),
            stopped_ms=self._control.stopped_ms,
        )
        width, speed = parse(width_m, Unit.MICROMETRE), parse(speed_m_s, Unit.MICROMETRE_PER_SECOND)
        force = parse(force_n, Unit.MILLINEWTON)

        def stopped() -> bool:
            return self._control.stops != stops

        def send() -> Grip:
            if stopped():
                permit.refusal = Reason.VERDICT_EXPIRED
                raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "a stop came before it was sent")
            return self._gripper.move(width_um=width, speed_um_s=speed, force_mn=force, stopped=stopped)

        sending = asyncio.get_running_loop().run_in_executor(self._fingers, send)
        try:
            while not sending.done():
                await asyncio.wait({sending}, timeout=STANDING_PERIOD_MS / 1000)
                if not sending.done() and permit.standing() is not None:
                    await self.stop()
        except asyncio.CancelledError:
            await self._finish_stopping()
            raise
        return sending.result()

    # -- stopping

    async def stop(self) -> MotionEnd:
        """The arm stands still, and the fingers; nothing that was asked for before will move them any more.

        The command goes out at once. If the arm still moves 0.7 s later, or the command cannot be given, the dashboard
        ends the program.
        """
        self._control.note_stop()
        loop = asyncio.get_running_loop()
        if self._stopping is None or self._stopping.done():
            self._stopping = loop.run_in_executor(self._stops, self._control.stopJ)
            self._stopping.add_done_callback(_seen)
        fingers = loop.run_in_executor(self._stops, self._gripper.halt)
        fingers.add_done_callback(_seen)
        began_ms = self._clock.monotonic_ms()
        escalated = False
        while True:
            failed = self._stopping.done() and self._stopping.exception() is not None
            state: JointState | None
            try:
                state = await self._read()
            except RobotError:
                state = None
            waited_ms = self._clock.monotonic_ms() - began_ms
            if state is not None and state.still and (self._stopping.done() or escalated):
                return MotionEnd(End.STOPPED, state.q_rad)
            if not escalated and (failed or waited_ms > ESCALATE_MS):
                escalated = True
                loop.run_in_executor(self._stops, self._dashboard_stop).add_done_callback(_seen)
            if waited_ms > STOP_LIMIT_MS:
                return MotionEnd(End.ROBOT_FAILED, () if state is None else state.q_rad, "no standstill was seen")
            await asyncio.sleep(POLL_S)

    async def _finish_stopping(self) -> None:
        """Stop, also when the task that asks is being cancelled."""
        stopping = asyncio.ensure_future(self.stop())
        while not stopping.done():
            try:
                await asyncio.shield(stopping)
            except asyncio.CancelledError:
                continue

    # -- looking

    async def _read(self) -> JointState:
        return await asyncio.get_running_loop().run_in_executor(self._reads, self._state.read)

    async def read_state(self) -> JointState:
        """The robot's state now.

        Raises:
            RobotError: when it says nothing.
        """
        return await self._read()

    async def close(self) -> None:
        """The arm stands still, its program has ended, and nothing can be sent any more."""
        await self._finish_stopping()
        loop = asyncio.get_running_loop()
        for end in (self._control.stopScript, self._control.disconnect):
            try:
                await asyncio.wait_for(loop.run_in_executor(self._stops, end), STOP_LIMIT_MS / 1000)
            except Exception:  # noqa: BLE001, S112 - the arm stands; what is left is tidying
                continue
        for pool in (self._commands, self._reads, self._fingers, self._stops):
            pool.shutdown(wait=False, cancel_futures=True)


def _near(a: Sequence[float], b: Sequence[float], tolerance_rad: float) -> bool:
    return len(a) == len(b) and all(abs(x - y) <= tolerance_rad for x, y in zip(a, b, strict=True))


def _seen(ended: asyncio.Future[None]) -> None:
    """A stop that failed is judged by the arm itself, which is watched until it stands."""
    if not ended.cancelled():
        ended.exception()

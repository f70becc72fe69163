"""Moving at joint speeds for a time: a stream that is sent again and again, watched, and ended in time.

Three things end it, each without the others: its time is over, or nobody looks any more at the arm, the authority and
the world behind it (this module); a stop (`PermittedControl`); nothing is sent any more (the controller's watchdog).
"""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.errors import QuantityError
from capabilities.values.units import parse
from pep.base.errors import ActuationRefusedError, PepFault
from pep.base.operations import SPEED_JOINT
from pep.base.stop_model import ESCALATE_MS, SAFE_MODES
from pep.rtde.motion.stop_ladder import STOP_LIMIT_MS, MotionEnd
from pep.rtde.robot.newest_state import SILENCE_MS
from pep.watch.watch import PAUSE_S, MotionOutcome
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Sequence

    from capabilities.values.errors import Fault
    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.motion.drive import Drive
    from pep.rtde.motion.permitted_control import PermittedControl
    from pep.rtde.robot.newest_state import NewestState
    from policies.evidence.model import Request

SEND_S: Final = 0.02
"""Pause between two sends: ten packages of the controller, a fifteenth of its patience."""
EARLIER_PERIOD_MS: Final = 40
"""How often the authority of the permits before the newest is asked again: well inside the 150 ms to a stop."""
UNSEEN_MS: Final = 200
"""A stream whose arm and authority nobody has looked at for this long is ended by whoever sends it."""


@dataclass(slots=True)
class _Stream:
    """A stream under way.

    Attributes:
        agent: whose it is.
        speeds: six speeds and the acceleration, as integers of their units.
        permits: the one that began it, and those that prolonged it. The authority of all has to stand; the newest one
            says what may be left of the motion.
        ended: how it ended, for everybody who waits.
        looked_ms: when arm and authority were looked at.
    """

    agent: str
    speeds: tuple[int, ...]
    permits: list[Permit]
    ended: asyncio.Future[MotionEnd]
    looked_ms: int


class Jog:
    """Streams of joint speeds, one at a time.

    Args:
        drive: of the arm; it reads, watches, stops, and holds the slot.
        control: guarded.
        start_of: joint angles from which a request was assessed.
        clock: both clocks.
    """

    def __init__(
        self,
        drive: Drive,
        control: PermittedControl,
        *,
        start_of: Callable[[str], tuple[float, ...] | None],
        clock: Clock,
    ) -> None:
        self._drive = drive
        self._control = control
        self._start_of = start_of
        self._clock = clock
        self._stream: _Stream | None = None
        self._senders = ThreadPoolExecutor(2, "jog")

    def joins(self, request: Request, *, agent: str) -> bool:
        """Whether the request, of that agent, asks for the very speeds of the stream under way."""
        stream = self._stream
        return (
            stream is not None
            and agent != ""
            and (agent, SPEED_JOINT.object, SPEED_JOINT.name) == (stream.agent, request.object, request.operation)
            and tuple(v.value for v in request.values[: len(stream.speeds)]) == stream.speeds
        )

    async def speed_joint(
        self, qd_rad_s: Sequence[float], acceleration_rad_s2: float, duration_s: float, permit: Permit
    ) -> MotionEnd:
        """The arm has moved at these speeds, and why it stands again. Who prolongs a stream waits for its end too.

        Args:
            qd_rad_s: 6 joint speeds.
            acceleration_rad_s2: of the leading axis.
            duration_s: how long, without the stop.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the robot could not be read before sending; nothing was sent.
        """
        numbers = (*qd_rad_s, acceleration_rad_s2, duration_s)
        stream = self._stream
        if stream is None:
            return await self._begin(numbers, permit)
        if permit.agent != stream.agent or _integers(numbers)[:-1] != stream.speeds:
            raise ActuationRefusedError(Reason.BUSY, "another stream is under way")
        try:
            await self._send(numbers, permit)
            stream.permits.append(permit)
            return await asyncio.shield(stream.ended)
        except asyncio.CancelledError:
            await self._drive.stop_although_cancelled()
            raise

    def close(self) -> None:
        """Nothing is sent any more."""
        self._senders.shutdown(wait=False, cancel_futures=True)

    async def _begin(self, numbers: tuple[float, ...], permit: Permit) -> MotionEnd:
        if not self._drive.reserve(permit.request_id):
            raise ActuationRefusedError(Reason.VERDICT_EXPIRED, "the stream that it would have prolonged has ended")
        start = await self._drive.read_state()
        permit.begins(assessed_rad=self._start_of(permit.request_id), at_rad=start.q_rad)
        loop = asyncio.get_running_loop()
        stream = _Stream(
            permit.agent, _integers(numbers)[:-1], [permit], loop.create_future(), self._clock.monotonic_ms()
        )
        end = MotionEnd(MotionOutcome.STOPPED, ())
        try:
            end = await self._drive.watched(lambda gone: self._follow(stream, numbers, gone), permit)
        finally:
            self._stream = None
            stream.ended.set_result(end)
        return end

    async def _send(self, numbers: tuple[float, ...], permit: Permit) -> None:
        def send() -> None:
            self._control.speedJ(numbers[:6], *numbers[6:], permit=permit)

        await asyncio.get_running_loop().run_in_executor(self._senders, send)

    def _follow(self, stream: _Stream, numbers: tuple[float, ...], gone: threading.Event) -> MotionEnd:
        """Sent, and looked at until it has ended and the arm stands. On the drive's watching thread."""
        permit = stream.permits[0]
        arm = self._drive.heard()
        self._control.speedJ(numbers[:6], *numbers[6:], permit=permit)
        self._stream = stream
        stream.looked_ms = standing_ms = self._clock.monotonic_ms()
        holding = self._senders.submit(self._hold, stream)
        watch = self._drive.watching(permit)
        while not holding.done():
            arm.look()
            now = stream.looked_ms = self._clock.monotonic_ms()
            if stream.permits[-1] is not permit:
                permit = stream.permits[-1]
                watch = self._drive.watching(permit)
            if gone.is_set():
                return self._stand(holding)
            alarm = watch.look(arm.state.q_rad)
            if alarm is not None:
                return self._let_go(holding, self._drive.end_by(alarm, permit, arm.state))
            if now - standing_ms >= EARLIER_PERIOD_MS:
                standing_ms = now
                fault = _fallen(stream.permits[:-1])
                if fault is not None:
                    return MotionEnd(MotionOutcome.AUTHORITY_LOST, self._stand(holding).q_rad, str(fault.code))
            if arm.silent_ms > SILENCE_MS:
                self._stand(holding)
                return MotionEnd(MotionOutcome.ROBOT_FAILED, (), str(PepFault.ROBOT_STALLED))
            if arm.state.safety_mode not in SAFE_MODES:
                mode = arm.state.safety_mode
                return MotionEnd(MotionOutcome.ROBOT_FAILED, self._stand(holding).q_rad, f"safety mode {mode}")
            wait((holding,), timeout=PAUSE_S)
        return self._ended(stream, arm, holding.result())

    def _stand(self, holding: Future[str]) -> MotionEnd:
        """The arm stands."""
        return self._let_go(holding, self._drive.stand())

    def _let_go(self, holding: Future[str], end: MotionEnd) -> MotionEnd:
        """That end, once whoever holds the stream has seen the stop; a second stop would end the program."""
        wait((holding,), timeout=STOP_LIMIT_MS / 1000)
        return end

    def _ended(self, stream: _Stream, arm: NewestState, why: str) -> MotionEnd:
        """The stream is over; once the arm stands, how."""
        ended_ms = arm.sent()
        while self._clock.monotonic_ms() - ended_ms <= ESCALATE_MS and arm.silent_ms <= SILENCE_MS:
            if arm.look() and arm.state.still:
                stopped_ms = self._control.stopped_ms
                if stopped_ms is not None and stopped_ms >= stream.permits[0].since_ms:
                    return MotionEnd(MotionOutcome.STOPPED, arm.state.q_rad)
                return MotionEnd(MotionOutcome.ROBOT_FAILED if why else MotionOutcome.ENDED, arm.state.q_rad, why)
            time.sleep(PAUSE_S)
        return MotionEnd(MotionOutcome.ROBOT_FAILED, self._drive.stand().q_rad, why or "still moving after its end")

    def _hold(self, stream: _Stream) -> str:
        """Sends until the end, in a thread of its own; "" when the time was over, else why it ended before."""
        try:
            while (left_ms := self._control.speed_left_ms) > 0:
                if self._clock.monotonic_ms() - stream.looked_ms > UNSEEN_MS:
                    return "nobody looked"
                if not self._control.hold_speed():
                    break  # its last moment is over, or a stop has come, which whoever waits can see
                time.sleep(min(SEND_S, left_ms / 1000))
        except ActuationRefusedError as refused:
            return str(refused.reason)
        else:
            return ""
        finally:
            self._control.end_speed()


def _fallen(permits: Sequence[Permit]) -> Fault | None:
    """The first fault of an authority that no longer stands."""
    return next((fault for permit in permits if (fault := permit.standing()) is not None), None)


def _integers(numbers: tuple[float, ...]) -> tuple[int, ...]:
    """The numbers in the units of the operation's parameters; empty when they are none."""
    try:
        return tuple(parse(n, p.unit) for n, p in zip(numbers, SPEED_JOINT.parameters, strict=True))
    except (QuantityError, ValueError):
        return ()

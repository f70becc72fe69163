"""The commands of a program in this process: held until they are judged, and handed over as they were judged.

What the gateway does to a program's packages is done here to its calls, by the same judge. The program's own thread
makes each call of the raw object, and waits in it; what is judged, watched and timed runs on the judge's event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from concurrent.futures import CancelledError, Future, InvalidStateError
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from capabilities.values.units import Unit
from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import CommandClass, Wait, row_of
from pep.rtde.command.rounding import on_grid
from pep.rtde.command.stop_rules import MODES, STOPS, ended_by, raised
from pep.rtde.judge.command_requests import stands_s
from pep.rtde.judge.stream_values import LATE_MS
from pep.rtde.line.effects import PATIENCE_MS
from pep.rtde.method_calls import call_of, rebuilt
from pep.rtde.motion.brake import Brake
from pep.rtde.motion.control_interface import STOP_PATIENCE_S, UNWATCHED_HZ, ControlInterface
from pep.rtde.wire.refusal import Refused
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from pep.base.ports import Clock
    from pep.rtde.command.command_table import Row
    from pep.rtde.command.command_values import Command
    from pep.rtde.robot.judge_port import Holder, Judge, Steps
    from pep.rtde.script.move_path import Waypoint

HANDED_MS: Final = 100
"""Ours: what was permitted is handed over within twice the lifetime of a verdict, or not at all."""
STEP_S: Final = 1.0
"""Ours: a value of a stream that is not judged by then is refused, and the arm stopped. It takes a millisecond."""
LOOK_S: Final = 0.02
"""How often a stream is asked whether its program still calls."""
MOVES_STOP: Final = STOPS[34]
"""What ends a move; still to be raised."""


class NotingStopper(Protocol):
    """A `pep.rtde.robot.judge_port.Stopper` that is told of the stops that others have sent."""

    def stop(self, reason: Reason) -> None:
        """See `Stopper.stop`."""
        ...

    def note(self) -> None:
        """Somebody has stopped the arm another way."""
        ...

    @property
    def stopped_ms(self) -> int | None:
        """See `Stopper.stopped_ms`."""
        ...


@dataclass(frozen=True, slots=True)
class _Permitted:
    steps: Steps | None
    at_ms: int


@dataclass(frozen=True, slots=True)
class _Denied:
    reason: Reason
    told: str


class _Held:
    """A call that waits, as the judge has it (`pep.rtde.robot.judge_port.Held`)."""

    def __init__(self, calls: HeldCalls, command: Command, path: tuple[Waypoint, ...], *, stops: int) -> None:
        self._calls = calls
        self._command = command
        self._path = path
        self.stops = stops  # there were so many when it was asked for
        self.answer: Future[_Permitted | _Denied] = Future()

    @property
    def command(self) -> Command:
        return self._command

    @property
    def path(self) -> tuple[Waypoint, ...]:
        return self._path

    @property
    def lease(self) -> Holder:
        return self._calls.holder

    def forward(self, steps: Steps | None = None) -> bool:
        return self._answered(_Permitted(steps, self._calls.clock.monotonic_ms()))

    def deny(self, reason: Reason, told: str) -> None:
        self._answered(_Denied(reason, told))

    def defer(self, told: str) -> None:
        if row_of(self._command).wait is Wait.AT_ONCE:
            # As through the gateway: a program that streams must not stand in a call for a minute.
            if self._answered(_Denied(Reason.APPROVAL_REQUIRED, told)):
                self._calls.judge.withdrawn(self)
        else:
            self._calls.tell(Reason.APPROVAL_REQUIRED, told)

    def stop(self, reason: Reason, told: str) -> None:
        self._calls.halt(self, reason, told)

    def _answered(self, answer: _Permitted | _Denied) -> bool:
        try:
            self.answer.set_result(answer)
        except InvalidStateError:  # it waits no longer
            return False
        return True


@dataclass(eq=False, slots=True)
class _UnderWay:
    """What was handed over last.

    Attributes:
        held: as it was asked for.
        row: of its command.
        value: the command that stands.
        steps: judge the values that follow.
        inside: whether the control script is inside of it and reads no register.
        goes_on: whether nothing has ended it, as far as it is known here.
        heard_ms: monotonic time of the newest value.
        lost: why we have ended it, while its program does not know.
    """

    held: _Held
    row: Row
    value: Command
    steps: Steps | None
    inside: bool
    heard_ms: int
    goes_on: bool = True
    lost: tuple[Reason, str] | None = None

    @property
    def ends(self) -> v.Stop:
        """What ends it, still to be raised."""
        return MODES.get(self.row.id, MOVES_STOP)

    @property
    def rhythm_ms(self) -> int:
        """Within so long its program says the next value, or ends it."""
        match self.value:
            case v.SpeedJ(_, _, time_s) | v.SpeedL(_, _, time_s):
                lasts_s = stands_s(time_s)
            case v.ServoJ(_, time_s, _, _) | v.ServoL(_, time_s, _, _):
                lasts_s = time_s
            case _:
                lasts_s = stands_s(0.0)
        return round(lasts_s * Unit.MILLISECOND.per_si) + LATE_MS


class HeldCalls(ControlInterface):
    """Commands go to the judge, stops past it, questions by it.

    Args:
        control: the raw `RTDEControlInterface`; keep no other reference to it.
        judge: decides; it lives on `loop`.
        stopper: of the arm, the judge's own.
        holder: by whose authority.
        loop: an event loop that runs in another thread than the program's.
        restarting: opens a block in which this program sends its control script again, for whoever tells it from
            another program: `pep.rtde.robot.program.ProgramWatch.restarted`.
        clock: the monotonic one counts.
        stop_deceleration_rad_s2: the cell's stop model, of the leading axis: every stop is at least this hard.

    Attributes:
        reason: why the last command gave False, or what it waits for; None when there is nothing to tell.
        told: the same for people; "" then.

    Raises:
        ValueError: for a deceleration that no stop can have.
    """

    def __init__(
        self,
        control: Any,
        *,
        judge: Judge,
        stopper: NotingStopper,
        holder: Holder,
        loop: asyncio.AbstractEventLoop,
        restarting: Callable[[], AbstractContextManager[object]],
        clock: Clock,
        stop_deceleration_rad_s2: float,
    ) -> None:
        super().__init__(control, stop_deceleration_rad_s2=stop_deceleration_rad_s2)
        self.judge = judge
        self.holder = holder
        self.clock = clock
        self.reason: Reason | None = None
        self.told = ""
        self._stopper = stopper
        self._loop = loop
        self._restarting = restarting
        self._asking = threading.Lock()  # one command of the program at a time
        self._state = threading.Lock()  # of what follows; held for moments
        self._stops = 0
        self._waiting: _Held | None = None
        self._under_way: _UnderWay | None = None
        self._own_hz = UNWATCHED_HZ  # the program's own watchdog
        self._watched = False  # whether the controller watches over a stream
        self._brake = Brake("brake", self._brake_registers)

    # ---- the program's side, on its threads

    def _ask(self, command: Command | Refused, path: tuple[Waypoint, ...] = ()) -> bool:
        """Whether the command was permitted, handed over, and taken by the controller."""
        self._elsewhere()
        with self._asking:
            self.reason, self.told = None, ""
            if isinstance(command, Refused):
                if (stream := self._stream) is not None and stream.goes_on:
                    self._end(command.reason, command.place)
                return self._refused(command.reason, command.place)
            stream, row = self._stream, row_of(command)
            if stream is not None and stream.row is row and (stream.goes_on or stream.lost is not None):
                return self._step(stream, command)
            if not self._control.isProgramRunning():
                return self._refused(Reason.ROBOT_NOT_RUNNING, "no control script runs")
            held = _Held(self, on_grid(command), path, stops=self._stops)
            answer = self._judged(held)
            if isinstance(answer, _Denied):
                return self._refused(answer.reason, answer.told)
            return self._hand_over(held, answer)

    def _judged(self, held: _Held) -> _Permitted | _Denied:
        with self._state:
            self._waiting = held
        try:
            self._loop.call_soon_threadsafe(self._put, held)
            return held.answer.result(PATIENCE_MS / 1000)
        except CancelledError:
            return _Denied(Reason.VERDICT_EXPIRED, "a stop came while it waited")
        except TimeoutError:
            if not held.answer.cancel():
                return held.answer.result()
            self._later(self.judge.withdrawn, held)
            return _Denied(Reason.APPROVAL_TIMEOUT, "nobody decided in time")
        except RuntimeError:  # the loop is closed
            return _Denied(Reason.EVIDENCE_MISSING, "nobody decides")
        finally:
            with self._state:
                self._waiting = None

    def _hand_over(self, held: _Held, permitted: _Permitted) -> bool:
        row = row_of(held.command)
        inside = isinstance(held.command, v.Move) and not getattr(held.command, "asynchronous", False)
        running = _UnderWay(held, row, held.command, permitted.steps, inside, self.clock.monotonic_ms())
        with self._lock:
            if row.every_cycle:
                self._watch(1000.0 / (running.rhythm_ms + LATE_MS))
            with self._state:
                # Nothing may come between this and the command.
                late = self.clock.monotonic_ms() - permitted.at_ms > HANDED_MS
                void = late or self._stops != held.stops
                if not void and row.command_class is CommandClass.MOTION:
                    self._under_way, running.heard_ms = running, self.clock.monotonic_ms()
            if not row.every_cycle or void:
                self._ended(permitted.steps)
            if void:
                self._unwatched()
                return self._refused(Reason.VERDICT_EXPIRED, "a stop came, or it was too late")
            if row.every_cycle:
                self._later(self._look, running)
            return self._sent(running, stops=held.stops)

    def _step(self, running: _UnderWay, command: Command) -> bool:
        """The next value of the stream that stands; of one that we have stopped, the program learns it once."""
        lost, running.lost = running.lost, None
        if lost is not None:
            return self._refused(*lost)
        if running.steps is None:
            reason = None if command == running.value else Reason.NOT_WHAT_WAS_DECIDED
        else:
            reason = self._stepped(running.steps, command)
        if reason is not None:
            self._end(reason, running.row.name)
            running.lost = None
            return self._refused(reason, running.row.name)
        with self._lock:
            with self._state:
                if self._under_way is not running or not running.goes_on:
                    return self._refused(Reason.VERDICT_EXPIRED, "the stream is over")
                stops = self._stops
                if running.steps is not None:  # what nobody judged anew lasts no longer
                    running.value, running.heard_ms = command, self.clock.monotonic_ms()
            return self._sent(running, stops=stops)

    def _stepped(self, steps: Steps, command: Command) -> Reason | None:
        said: Future[Reason | None] = Future()

        def step() -> None:
            try:
                said.set_result(steps.step(command))
            except Exception:  # noqa: BLE001 - a judgement that breaks has not permitted
                said.set_result(Reason.POLICY_ERROR)

        try:
            self._loop.call_soon_threadsafe(step)
            return said.result(STEP_S)
        except (RuntimeError, TimeoutError):
            return Reason.WATCH_LATE

    def _sent(self, running: _UnderWay, *, stops: int) -> bool:
        """Whether the controller took it. Under the lock of the raw object."""
        taken = False
        try:
            taken = bool(self._give(running.value, running.held.path))
        finally:
            with self._state:
                waited, running.inside = running.inside, False
                stopped = self._stops != stops
                if waited or stopped or not taken:
                    running.goes_on = False
            if running is not self._under_way:
                pass  # nothing moves by it
            elif waited and not taken and not stopped:
                self._stopper.stop(Reason.EFFECT_FAILED)  # nobody knows what the script is in
            elif not waited and (stopped or not taken):
                # A stop counts before it sends: one that is not counted yet is sent after this command anyway.
                self._give(raised(running.ends, self._deceleration))
                self._unwatched()
                self._ended(running.steps)
        return taken or self._refused(Reason.EFFECT_FAILED, "the controller did not take the command, or was stopped")

    def _stop(self, stop: v.Stop) -> Any:
        """What the raw method says. The program's own stop: never judged, never waiting for what is."""
        with self._state:
            self._noted()
            waiting, running = self._waiting, self._under_way
            inside = running is not None and running.inside
            if running is not None and not inside:
                running.goes_on = False
        if waiting is not None and waiting.answer.cancel():
            self._later(self.judge.withdrawn, waiting)
        if running is not None:
            self._ended(running.steps)
            if inside:  # the script reads no register: its program is ended
                self._stopper.stop(Reason.VERDICT_EXPIRED)
                return None if isinstance(stop, v.StopJ | v.StopL) else True
            if running.row.id in MODES and not ended_by(stop, {running.row.id}):
                # Any other stop would meet the thread that moves the arm, and the controller ends a program in which
                # two threads do.
                stop = running.ends
        told = self._at_once(partial(self._give, raised(stop, self._deceleration)))
        self._unwatch()
        return told

    def _replace(self, name: str) -> Any:
        """The control script is sent again; whatever was under way is over."""
        self._stop_program()
        with self._lock, self._restarting():
            self._own_hz, self._watched = UNWATCHED_HZ, False
            return getattr(self._control, name)()

    def _stop_program(self) -> None:
        if self._control.isProgramRunning():
            self._stop(v.End(v.Ending.PROGRAM))

    def _set_watchdog(self, command: Command | Refused) -> bool:
        """The program's own; while one of ours stands, the quicker of both."""
        if not isinstance(command, v.SetWatchdog):
            assert isinstance(command, Refused)
            return self._refused(command.reason, command.place)
        with self._lock:
            self._own_hz = command.least_hz
            running = self._under_way
            if running is None or not (running.goes_on and self._watched):
                return bool(self._control.setWatchdog(self._own_hz))
            self._watch(1000.0 / (running.rhythm_ms + LATE_MS))
            return True

    # ---- the judge's side, on its loop

    def tell(self, reason: Reason, told: str) -> None:
        """The program finds this where it looks for reasons."""
        self.reason, self.told = reason, told

    def halt(self, held: _Held, reason: Reason, told: str) -> None:
        """What was handed over last is stopped, when it is that. Waits for nothing."""
        running = self._under_way
        if running is not None and running.held is held:
            self._end(reason, told)

    def _put(self, held: _Held) -> None:
        try:
            self.judge.judge(held)
        except Exception:  # noqa: BLE001 - a judgement that breaks has not permitted
            held.deny(Reason.POLICY_ERROR, "the judgement broke")

    def _look(self, running: _UnderWay) -> None:
        """A stream whose program has stopped calling is ended."""
        if not running.goes_on:
            return
        if self.clock.monotonic_ms() - running.heard_ms > running.rhythm_ms:
            self._end(Reason.VERDICT_EXPIRED, "the program has stopped calling")
        else:
            self._loop.call_later(LOOK_S, self._look, running)

    # ---- inside

    @property
    def _stream(self) -> _UnderWay | None:
        """What was handed over last, when the control script reads it in each cycle."""
        running = self._under_way
        return running if running is not None and running.row.every_cycle else None

    def _end(self, reason: Reason, told: str) -> None:
        """Our own stop of what was handed over last. From any thread; waits for nothing."""
        with self._state:
            running = self._under_way
            if running is None:
                return
            inside = running.inside
            if running.goes_on and not inside:
                running.goes_on, running.lost = False, (reason, told)
            self._noted()
        self.tell(reason, told)
        self._ended(running.steps)
        if inside:
            self._stopper.stop(reason)
        else:
            self._brake.take()

    def _brake_registers(self) -> None:
        running = self._under_way
        if running is not None:
            self._at_once(partial(self._give, raised(running.ends, self._deceleration)))
            self._unwatch()

    def _noted(self) -> None:
        self._stopper.note()
        self._stops += 1

    def _give(self, command: Command, path: tuple[Waypoint, ...] = ()) -> Any:
        name, arguments = call_of(command)
        if isinstance(command, v.MovePath):
            arguments.insert(0, rebuilt(path))
            with self._restarting():  # a path is sent as part of the control script
                return getattr(self._control, name)(*arguments)
        return getattr(self._control, name)(*arguments)

    def _watch(self, least_hz: float) -> None:
        """The controller ends the program when nothing is said for so long. Under the lock."""
        self._watched = True
        self._control.setWatchdog(max(least_hz, self._own_hz))

    def _unwatch(self) -> None:
        """No more; a command that is being handed over takes it away itself, when it is stopped."""
        if self._watched and self._lock.acquire(timeout=STOP_PATIENCE_S):
            try:
                self._unwatched()
            finally:
                self._lock.release()

    def _unwatched(self) -> None:
        if self._watched and self._control.isProgramRunning():
            self._control.setWatchdog(self._own_hz)
        self._watched = False

    def _ended(self, steps: Steps | None) -> None:
        if steps is not None:
            self._later(steps.ended)

    def _later(self, what: Callable[..., object], *arguments: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to hear it
            self._loop.call_soon_threadsafe(what, *arguments)

    def _refused(self, reason: Reason, told: str) -> bool:
        if self.reason is None or reason is not Reason.EFFECT_FAILED:  # what the judge said of it says more
            self.tell(reason, told)
        return False

    def _elsewhere(self) -> None:
        try:
            here = asyncio.get_running_loop()
        except RuntimeError:
            return
        if here is self._loop:
            raise RuntimeError("the judge's own loop cannot wait for its answer")

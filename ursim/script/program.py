"""A program that runs: its threads, scheduled cooperatively once a tick, and the rules that keep a bad one harmless."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from ursim.motion.motion import MotionError
from ursim.motion.robot import TICK_S
from ursim.motion.values import Pose, ScriptRuntimeError, Vector, copied, power

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import CodeType

    from ursim.motion.arm import Joints
    from ursim.motion.motion import Motion
    from ursim.motion.robot import Robot
    from ursim.script.compiler import Compiled
    from ursim.script.program_sockets import ProgramSocket

STEPS_PER_TICK: Final = 20_000  # loop turns and calls in one tick; the controller calls more an infinite loop
MAX_THREADS: Final = 50
FORCE_INPUT, FORCE_INPUT_HZ = "external_force_torque", 10.0  # URScript manual, enable_external_ft_sensor

Steps: TypeAlias = Generator[None, None, Any]


class Ended(Enum):
    """Reason for which a program is over."""

    FINISHED = "finished"
    HALTED = "halted"
    FAILED = "failed"
    WATCHDOG_STOP = "watchdog"
    WATCHDOG_PAUSE = "watchdog pause"


@dataclass(frozen=True, slots=True)
class Ending:
    """The end of a program, with the line and text of a runtime exception."""

    why: Ended
    line: int = 0
    text: str = ""


class _Halt(Exception):  # noqa: N818  a `halt` is no error
    pass


class _Killed(Exception):  # noqa: N818  a thread that killed itself
    pass


class Thread:
    """A handle as `run` gives it; equal to nothing but itself."""

    __slots__ = ("done", "steps")

    def __init__(self, steps: Steps) -> None:
        self.steps = steps
        self.done = False


@dataclass(slots=True)
class _Watchdog:
    variable: str
    patience_ticks: float
    since: int
    pauses: bool


class Execution:
    """One run of one program; the `R` of its code.

    Args:
        compiled: the program.
        robot: the robot that it acts on.

    Attributes:
        sockets: those that it has opened, by name.
    """

    def __init__(self, compiled: Compiled, robot: Robot) -> None:
        self.compiled = compiled
        self.robot = robot
        self.current: Thread
        self._steps = 0
        self._begun: list[Thread] = []
        self.sockets: dict[str, ProgramSocket] = {}
        self._watchdog: _Watchdog | None = None
        space: dict[str, Any] = {"R": self, "G": {}, "V": Vector, "P": Pose, "C": copied, "W": power}
        space |= {f"b_{name}": partial(function.call, self) for name, function in compiled.functions.items()}
        _define(compiled.code, space)
        self._threads = [Thread(space["main"]())]
        self.current = self._main = self._threads[0]

    def tick(self) -> Ending | None:
        """Runs every thread until it waits for the next tick; the ending when the program is over."""
        self._steps = 0
        if (expired := self._expired()) is not None:
            return expired
        waiting = list(self._threads)
        self._begun = []  # threads begun in this tick run in it too, after the others
        for thread in chain(waiting, self._begun):
            if thread.done:
                continue
            self.current = thread
            try:
                next(thread.steps)
            except StopIteration:
                self._end(thread)
                if thread is self._main:
                    return Ending(Ended.FINISHED)
            except _Killed:
                continue
            except _Halt:
                return Ending(Ended.HALTED)
            except MotionError as error:
                self.robot.alarm = str(error)
                return None
            except Exception as error:  # noqa: BLE001  any error of a program ends that program and nothing else
                return Ending(Ended.FAILED, self._line(error), _told(error))
        return None

    def finish(self) -> None:
        """Every thread is over; the arm is nobody's."""
        for thread in self._threads:
            thread.done = True
        self._threads.clear()
        for opened in self.sockets.values():
            opened.close()
        self.sockets.clear()

    def run_through(self) -> Ending:
        """A secondary program: all of it within one tick."""
        ending = self.tick()
        if ending is None:
            ending = Ending(Ended.FAILED, 0, "a secondary program must not take time")
        self.finish()
        return ending

    # -- calls of compiled programs

    def step(self) -> None:
        """Counts a loop turn or a call."""
        self._steps += 1
        if self._steps > STEPS_PER_TICK:
            raise ScriptRuntimeError("infinite loop detected")

    def start(self, steps: Steps) -> Thread:
        """`run`."""
        if len(self._threads) >= MAX_THREADS:
            raise ScriptRuntimeError("too many threads")
        thread = Thread(steps)
        self._threads.append(thread)
        self._begun.append(thread)
        return thread

    def kill(self, thread: object) -> None:
        """`kill`; a handle that is no thread, or is over, is left alone."""
        if isinstance(thread, Thread) and not thread.done:
            self._end(thread)
            if thread is self.current:
                raise _Killed

    def join(self, thread: object) -> Steps:
        """`join`: waits for its end."""
        while isinstance(thread, Thread) and not thread.done:
            yield

    def halt(self) -> None:
        """`halt`."""
        raise _Halt

    # -- calls of built-ins

    def perform(self, plan: Callable[[Joints], Motion]) -> Steps:
        """Brings the arm to rest, then makes the motion that `plan` lays out from there, to its end."""
        drive, owner = self.robot.drive, self.current
        if drive.moving:
            yield from self.brake(drive.stop_deceleration_rad_s2)
        motion = plan(drive.now.q)
        drive.take(owner, motion)
        while drive.motion is motion:
            yield

    def brake(self, deceleration_rad_s2: float) -> Steps:
        """Brings the arm to rest."""
        drive = self.robot.drive
        brake = drive.braking(self.current, deceleration_rad_s2)
        while drive.motion is brake:
            yield

    def wait(self, duration_s: float) -> Steps:
        """Lets time pass, at least one tick."""
        for _ in range(max(1, round(duration_s / TICK_S))):
            yield

    def watch(self, variable: str, min_frequency_hz: float, *, pauses: bool) -> None:
        """`rtde_set_watchdog`: the program stops or pauses when `variable` is written less often; 0 ends it."""
        if min_frequency_hz == 0.0:
            self._watchdog = None
        else:
            self._watchdog = _Watchdog(variable, 1.0 / (min_frequency_hz * TICK_S), self.robot.step, pauses)

    def watch_force(self, *, enabled: bool) -> None:
        """The vendor's own watchdog over a wrench that a client feeds in: none but where no other is set."""
        if enabled and self._watchdog is None:
            self.watch(FORCE_INPUT, FORCE_INPUT_HZ, pauses=True)
        elif not enabled and self._watchdog is not None and self._watchdog.variable == FORCE_INPUT:
            self._watchdog = None

    # -- inside

    def _expired(self) -> Ending | None:
        dog = self._watchdog
        if dog is None:
            return None
        last = max(dog.since, self.robot.written_at.get(dog.variable, 0))
        if self.robot.step - last <= dog.patience_ticks:
            return None
        if dog.pauses:
            dog.since = self.robot.step  # counts afresh when the program is resumed
            return Ending(Ended.WATCHDOG_PAUSE)
        return Ending(Ended.WATCHDOG_STOP, 0, f"{dog.variable} was not written in time")

    def _end(self, thread: Thread) -> None:
        thread.done = True
        if thread in self._threads:
            self._threads.remove(thread)
        self.robot.drive.release(thread)

    def _line(self, error: BaseException) -> int:
        line, trace = 0, error.__traceback__
        while trace is not None:
            if trace.tb_frame.f_code.co_filename == self.compiled.code.co_filename:
                line = self.compiled.lines[trace.tb_lineno - 1]
            trace = trace.tb_next
        return line


def _told(error: BaseException) -> str:
    if isinstance(error, ScriptRuntimeError):
        return str(error)
    if isinstance(error, KeyError | UnboundLocalError):
        return f"a name without a value: {error}"
    return f"{type(error).__name__}: {error}"


def _define(code: CodeType, space: dict[str, Any]) -> None:
    """Runs the definitions of a compiled program; it can name only the members of `space`."""
    space["__builtins__"] = {"bool": bool}
    exec(code, space)  # noqa: S102  the compiler wrote it from checked nodes; see there

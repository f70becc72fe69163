"""The controller: one state, one thread that changes it, once every 2 ms.

Other threads (connections) hand in their messages; these take effect at the start of the next tick, in order. What a
tick produces goes out through `listeners`, called at its end.
"""

from __future__ import annotations

import time
from collections import deque
from concurrent.futures import Future
from enum import Enum
from typing import TYPE_CHECKING, Final, TypeVar

from ursim.motion.motion import MotionError
from ursim.motion.robot import TICK_S, UNSTOPPED, OperationalMode, Robot, RobotMode, RuntimeState, SafetyMode
from ursim.motion.safety import SafetyLimits
from ursim.script.program import Ended, Execution

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.rtde.wire.codec import Value
    from ursim.motion.robot import Cause
    from ursim.ports.gripper import Gripper
    from ursim.script.compiler import Compiled

MAX_INBOX: Final = 4096  # writes waiting for the next tick; a connection that outruns the controller waits for it
ANSWER_DEADLINE_S: Final = 5.0  # for a question to the tick thread; it answers within one tick unless the host stalls
UNLOCK_AFTER_S: Final = 5.0  # a protective stop cannot be released sooner, as on the real controller
POWER_STEP_S: Final = 0.5  # time for each step of powering up; the real one takes longer, clients poll for up to 30 s
_LADDER: Final = (RobotMode.POWER_OFF, RobotMode.BOOTING, RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)
_NO_POWER: Final = frozenset(
    [SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.VIOLATION, SafetyMode.FAULT]
)

T = TypeVar("T")


class Refusal(Enum):
    """Reason for which a program is not taken."""

    LOCAL = "the controller is in local control"
    NOT_READY = "the robot is not ready to run a program"


class Event(Enum):
    """Event that primary clients are told of."""

    STARTED = "PROGRAM_XXX_STARTED"
    STOPPED = "PROGRAM_XXX_STOPPED"


class Controller:
    """Owns the robot, runs programs, keeps the safety state.

    Args:
        robot: the state; from now on only `tick` changes it.
        gripper: moved by the same tick.

    Attributes:
        remote: whether a person at its panel has given it to its ports (remote control), or kept it (local control).
            A program that runs when a person switches goes on.
    """

    def __init__(self, robot: Robot, gripper: Gripper) -> None:
        self.robot = robot
        self.gripper = gripper
        self.listeners: list[Callable[[], None]] = []
        self.on_event: Callable[[Event, str], object] = _unheard
        self.on_exception: Callable[[int, str], object] = _unheard
        self.on_operational_mode: Callable[[OperationalMode], object] = _unheard
        self.program_name = ""
        self.loaded: Compiled | None = None  # what `play` begins where no program waits
        self.remote = True
        self._limits = SafetyLimits(robot)
        self._reduced = False
        self._execution: Execution | None = None
        self._next: Compiled | None = None
        self._inbox: deque[Mapping[str, Value] | Callable[[], None]] = deque()
        self._stopped_at: int | None = None  # step of the last protective stop
        self._power_goal = RobotMode.RUNNING
        self._power_due = 0

    @property
    def obeys(self) -> bool:
        """True where it takes programs and power over its ports: in remote control, and not in manual mode.

        Manual mode is for a person at the panel; the ports are then as in local control.
        """
        return self.remote and self.robot.operational is not OperationalMode.MANUAL

    # -- for other threads

    def write(self, inputs: Mapping[str, Value]) -> None:
        """`inputs` are written at the start of the next tick. Waits while the controller is behind."""
        while len(self._inbox) >= MAX_INBOX:
            time.sleep(TICK_S)
        self._inbox.append(inputs)

    def ask(self, question: Callable[[], T]) -> T:
        """The answer to `question`, computed by the tick thread.

        Raises:
            TimeoutError: the controller does not tick.
        """
        answer: Future[T] = Future()

        def settle() -> None:
            try:
                answer.set_result(question())
            except Exception as error:  # noqa: BLE001  the asker's problem, never the tick's
                answer.set_exception(error)

        self._inbox.append(settle)
        return answer.result(ANSWER_DEADLINE_S)

    # -- the tick

    def tick(self) -> None:
        """Two milliseconds of the controller's life."""
        robot = self.robot
        robot.step += 1
        for _ in range(len(self._inbox)):
            received = self._inbox.popleft()
            if callable(received):
                received()
            else:
                robot.write(received)
        self._power()
        self._run()
        self._limits.slow()
        try:
            robot.drive.advance(TICK_S)
        except MotionError as error:
            robot.alarm = str(error)
        robot.feel()
        if robot.overloaded:
            robot.alarm = "a joint would need more torque than it has"
        if robot.alarm is not None:
            self._protective_stop(robot.alarm)
        if robot.safety in UNSTOPPED and (cause := self._limits.exceeded()) is not None:
            self._violate(cause)
        self._settle()
        self.gripper.tick(TICK_S)
        for listener in self.listeners:
            listener()

    def _run(self) -> None:
        if self._execution is None or self.robot.runtime is not RuntimeState.PLAYING:
            return
        ending = self._execution.tick()
        if ending is None:
            return
        if ending.why is Ended.WATCHDOG_PAUSE:
            self.pause()
            return
        if ending.why in (Ended.FAILED, Ended.WATCHDOG_STOP):
            self.on_exception(ending.line, ending.text)
        self._end()

    def _settle(self) -> None:
        """A state that waits for the arm to be still, or to go on, does so."""
        robot = self.robot
        match robot.runtime:
            case RuntimeState.STOPPING if not robot.drive.moving:
                robot.runtime = RuntimeState.STOPPED
                if self._next is not None:
                    self._begin(self._next)
            case RuntimeState.PAUSING if not robot.drive.moving:
                robot.runtime = RuntimeState.PAUSED
            case RuntimeState.RESUMING:
                robot.runtime = RuntimeState.PLAYING
            case _:
                pass

    # -- programs; called in the tick thread

    def load(self, compiled: Compiled) -> Refusal | None:
        """Runs a program once the arm is still, in place of the running one; the refusal when it cannot.

        A secondary program runs at once, beside the running one.
        """
        robot = self.robot
        if not self.obeys:
            return Refusal.LOCAL
        if compiled.secondary:
            ending = Execution(compiled, robot).run_through()
            if ending.why is Ended.FAILED:
                self.on_exception(ending.line, ending.text)
            return None
        if robot.mode is not RobotMode.RUNNING or robot.safety not in UNSTOPPED:
            return Refusal.NOT_READY
        self._end()
        self._next = compiled
        self._settle()
        return None

    def stop(self) -> None:
        """No program runs; the arm brakes. A stop is never refused."""
        self._end()
        self._settle()

    def pause(self) -> bool:
        """The running program waits, the arm brakes; whether there was one."""
        if self.robot.runtime is not RuntimeState.PLAYING:
            return False
        self.robot.drive.suspend()
        self.robot.runtime = RuntimeState.PAUSING
        return True

    def play(self) -> bool:
        """A paused program goes on, or the loaded one begins; whether there was one and it may."""
        robot = self.robot
        if robot.runtime is RuntimeState.STOPPED and self.loaded is not None:
            return self.load(self.loaded) is None
        if not self.obeys or robot.runtime is not RuntimeState.PAUSED or robot.safety not in UNSTOPPED:
            return False
        robot.drive.resume()
        robot.runtime = RuntimeState.RESUMING
        return True

    def _begin(self, compiled: Compiled) -> None:
        self._next = None
        self._execution = Execution(compiled, self.robot)
        self.program_name = compiled.name
        self.robot.runtime = RuntimeState.PLAYING
        self.on_event(Event.STARTED, compiled.name)

    def _end(self) -> None:
        self._next = None
        self.robot.drive.halt()
        if self._execution is not None:
            self._execution.finish()
            self._execution = None
            self.on_event(Event.STOPPED, self.program_name)
        self.robot.runtime = RuntimeState.STOPPING

    def set_operational_mode(self, mode: OperationalMode) -> None:
        """Sets the operational mode, and tells every listener of a change.

        A running program goes on.
        """
        if self.robot.operational is not mode:
            self.robot.operational = mode
            self.on_operational_mode(mode)

    # -- safety and power; called in the tick thread

    def _protective_stop(self, reason: str) -> None:
        robot = self.robot
        robot.alarm = None
        if robot.safety in _NO_POWER:
            return
        robot.safety = SafetyMode.PROTECTIVE_STOP
        self._stopped_at = robot.step
        self.on_exception(0, f"protective stop: {reason}")
        self._hold()

    def _violate(self, cause: Cause) -> None:
        """A safety limit was exceeded: a stop of category 0, and the safety system must be restarted."""
        self.on_exception(0, f"safety limit exceeded: {cause.name}")
        self.emergency_stop(SafetyMode.VIOLATION)

    def reduced_mode(self, *, on: bool) -> None:
        """The safety input for reduced mode: its limits apply, or those of normal mode again."""
        self._reduced = on
        if self.robot.safety in UNSTOPPED:
            self._calm()

    def _calm(self) -> None:
        self.robot.safety = SafetyMode.REDUCED if self._reduced else SafetyMode.NORMAL

    def _hold(self) -> None:
        waiting = self.robot.runtime in (RuntimeState.PAUSING, RuntimeState.PAUSED)
        if not waiting and not self.pause():  # a second stop takes nothing from the motion that waits
            self.robot.drive.halt()

    def emergency_stop(self, safety: SafetyMode = SafetyMode.ROBOT_EMERGENCY_STOP) -> None:
        """A button, or the safety system itself: the arm brakes, the program is over, the power goes."""
        self.robot.safety = safety
        self.power_off()

    def release_emergency_stop(self) -> None:
        """The button is pulled out; power stays off."""
        if self.robot.safety in (SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP):
            self._calm()

    def safeguard_stop(self) -> None:
        """A safeguard input opens: the arm brakes, the program waits, the power stays."""
        if self.robot.safety in UNSTOPPED:
            self.robot.safety = SafetyMode.SAFEGUARD_STOP
            self._hold()

    def release_safeguard_stop(self) -> None:
        """Closes the safeguard input; the program goes on once it is played."""
        if self.robot.safety is SafetyMode.SAFEGUARD_STOP:
            self._calm()

    def restart_safety(self) -> None:
        """Restarts the safety system after a violation or a fault, without power. No button is pulled out by it."""
        if self.robot.safety in (SafetyMode.VIOLATION, SafetyMode.FAULT):
            self._calm()
        self.power_off()

    def unlock_protective_stop(self) -> bool:
        """Releases a protective stop that is old enough; whether it did, or there was none."""
        robot = self.robot
        if robot.safety is not SafetyMode.PROTECTIVE_STOP:
            return True
        if self._stopped_at is not None and (robot.step - self._stopped_at) * TICK_S < UNLOCK_AFTER_S:
            return False
        self._calm()
        return True

    def ages(self) -> None:
        """Lets the protective stop that there is be old enough to be released."""
        self._stopped_at = None

    def power_on(self) -> None:
        """Towards power, brakes still closed."""
        if self.robot.mode is RobotMode.POWER_OFF and self.robot.safety not in _NO_POWER:
            self._aim_power(RobotMode.IDLE)

    def brake_release(self) -> None:
        """Powers up towards running, from any mode."""
        if self.robot.mode is not RobotMode.RUNNING and self.robot.safety not in _NO_POWER:
            self._aim_power(RobotMode.RUNNING)

    def power_off(self) -> None:
        """No program, and no power once the arm is still."""
        self.stop()
        self._power_goal = RobotMode.POWER_OFF

    def _aim_power(self, goal: RobotMode) -> None:
        self._power_goal = goal
        self._power_due = self.robot.step + round(POWER_STEP_S / TICK_S)

    def _power(self) -> None:
        robot = self.robot
        if self._power_goal is robot.mode:
            return
        if self._power_goal is RobotMode.POWER_OFF:
            if not robot.drive.moving:
                robot.mode = RobotMode.POWER_OFF
            return
        if robot.step >= self._power_due:
            robot.mode = _LADDER[_LADDER.index(robot.mode) + 1]
            self._aim_power(self._power_goal)


def _unheard(*told: object) -> None:
    del told

"""The stop ladder: arm and fingers at once, the dashboard when the arm goes on, and standstill seen before it is told.

Any thread may stop, and no stop waits: each rung that may block has a thread of its own, one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.stop_model import ESCALATE_MS, SAFE_MODES
from pep.rtde.motion.brake import Brake
from pep.watch.watch import MotionOutcome

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from pep.base.ports import Clock
    from pep.rtde.motion.permitted_control import PermittedControl
    from pep.rtde.robot.state_receiver import Package
    from pep.watch.governor import Change

STOP_LIMIT_MS: Final = 5_000


@dataclass(frozen=True, slots=True)
class MotionEnd:
    """The end of a motion: how, where, and why if it was cut short.

    Attributes:
        end: how.
        q_rad: joint angles.
        reason: a code, or "".
        changes: of its speed on the way, in order.
    """

    end: MotionOutcome
    q_rad: tuple[float, ...]
    reason: str = ""
    changes: tuple[Change, ...] = ()


class StopLadder:
    """Every way to stop what this cell moves.

    Args:
        control: guarded; its `stopJ` brakes as the cell's stop model says.
        halt: the fingers stop where they are.
        dashboard_stop: the last rung.
        newest: the newest package of the robot; never waits.
        clock: the monotonic one counts.
    """

    def __init__(
        self,
        *,
        control: PermittedControl,
        halt: Callable[[], None],
        dashboard_stop: Callable[[], None],
        newest: Callable[[], Package],
        clock: Clock,
    ) -> None:
        self._control = control
        self._newest = newest
        self._clock = clock
        self._arm = Brake("stop arm", control.stopJ)
        self._fingers = Brake("stop fingers", halt)
        self._dashboard = Brake("stop program", dashboard_stop)

    def begin(self) -> Stop:
        """The stop is on its way when this returns, and every permit of an earlier request is void."""
        self._control.note_stop()
        arm = self._arm.take()
        self._fingers.take()
        return Stop(arm, self._dashboard.take, newest=self._newest, clock=self._clock)


class Stop:
    """One stop under way, to be looked at until the arm stands. One thread looks.

    Args:
        arm: how telling the arm to stop has ended.
        escalate: the next rung; told once, when the first does not help.
        newest: the newest package of the robot; never waits.
        clock: the monotonic one counts.
    """

    def __init__(
        self,
        arm: Future[None],
        escalate: Callable[[], object],
        *,
        newest: Callable[[], Package],
        clock: Clock,
    ) -> None:
        self._arm = arm
        self._escalate = escalate
        self._newest = newest
        self._clock = clock
        self._began_ms = clock.monotonic_ms()
        self._began_at = newest().stamp_s
        self._escalated = False

    def look(self) -> MotionEnd | None:
        """The end, once standstill was seen; None while it is not. Escalates when the command fails or does not help.

        What the robot said before the stop tells nothing: only a newer package counts.
        """
        package = self._newest()
        heard = package.stamp_s != self._began_at and package.state is not None
        given = self._arm.done()
        waited_ms = self._clock.monotonic_ms() - self._began_ms
        failed = given and self._arm.exception() is not None
        # A program that a safety stop has paused does not hear us, and would go on with its motion afterwards.
        failed = failed or (heard and package.state is not None and package.state.safety_mode not in SAFE_MODES)
        if not self._escalated and (failed or waited_ms > ESCALATE_MS):
            self._escalated = True
            self._escalate()
        if heard and package.state is not None and package.state.still and (given or self._escalated):
            return MotionEnd(MotionOutcome.STOPPED, package.state.q_rad)
        if waited_ms > STOP_LIMIT_MS:
            where = package.state.q_rad if heard and package.state is not None else ()
            return MotionEnd(MotionOutcome.ROBOT_FAILED, where, "no standstill was seen")
        return None

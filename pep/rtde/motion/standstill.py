"""Standstill of an arm that was told to stop, with a harder stop when it is late.

The kinds of stops and their order are in `pep.rtde.line.lease_stop`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.stop_model import ESCALATE_MS, SAFE_MODES
from pep.watch.watch import MotionOutcome

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
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


class Standstill:
    """One stop under way, looked at by one thread until the arm stands. Made before the stop is given.

    Args:
        escalate: the harder stop; told once, when the given one does not help.
        newest: the newest package of the robot; never waits.
        clock: the monotonic one counts.
    """

    def __init__(self, escalate: Callable[[], object], *, newest: Callable[[], Package], clock: Clock) -> None:
        self._escalate = escalate
        self._newest = newest
        self._clock = clock
        self._began_ms = clock.monotonic_ms()
        self._began_at = newest().stamp_s
        self._escalated = False

    def look(self) -> MotionEnd | None:
        """The end, once standstill was seen; None while it is not. Escalates when the stop does not help.

        What the robot said before the stop tells nothing: only a newer package counts.
        """
        package = self._newest()
        state = package.state if package.stamp_s != self._began_at else None
        waited_ms = self._clock.monotonic_ms() - self._began_ms
        # A program that a safety stop has paused does not hear us, and would go on with its motion afterwards.
        paused = state is not None and state.safety_mode not in SAFE_MODES
        if not self._escalated and (paused or waited_ms > ESCALATE_MS):
            self._escalated = True
            self._escalate()
        if state is not None and state.still:
            return MotionEnd(MotionOutcome.STOPPED, state.q_rad)
        if waited_ms > STOP_LIMIT_MS:
            where = state.q_rad if state is not None else ()
            return MotionEnd(MotionOutcome.ROBOT_FAILED, where, "no standstill was seen")
        return None

"""Stop ladder of a lease: registers, a program of our own, the dashboard; each after the one before failed.

Pure: the controller's state and the time are arguments, the next rung is the result.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Final

from pep.base.stop_model import ESCALATE_MS, SAFE_MODES, STOP_DELAY_S

if TYPE_CHECKING:
    from pep.rtde.robot.state_receiver import Package

STOPPED: Final = 1
"""`runtime_state` of no program."""
PLAYING: Final = 2
"""`runtime_state` of a program that runs."""
OBEYS_MS: Final = round(1000 * STOP_DELAY_S) + 40
"""Time after which an arm that is no slower has not heard the registers: the brakes' delay, and a little."""


class StopMeans(Enum):
    """One way to stop the arm."""

    REGISTERS = "registers"
    """Order the control script to stop; it goes on."""
    PROGRAM = "program"
    """Replace the script by a program that only stops."""
    DASHBOARD = "dashboard"
    """End the running program, of any sender."""


class LeaseStopLadder:
    """Stops of one robot, with the rung that they have reached."""

    def __init__(self) -> None:
        self._rung: StopMeans | None = None
        self._since_ms = 0
        self._speed = 0.0

    @property
    def over(self) -> bool:
        """True while no stop is under way: the arm was seen to stand."""
        return self._rung is None

    def begin(self, rung: StopMeans, *, newest: Package, at_ms: int) -> bool:
        """Begins a stop; true where its rung is to be taken now. A lower one than before changes nothing."""
        if self._rung is not None and _ORDER.index(rung) <= _ORDER.index(self._rung):
            return False
        self._take(rung, newest, at_ms)
        return True

    def look(self, newest: Package, *, at_ms: int, carried_out: bool = True) -> StopMeans | None:
        """Rung to be taken now, or None. A report from before the stop does not count.

        Args:
            newest: newest state of the controller.
            at_ms: monotonic time.
            carried_out: whether the control script is in no stop by register, and about to be in none.
        """
        if self._rung is None:
            return None
        heard = newest.arrived_ms > self._since_ms
        if heard and newest.still and self._done(newest, carried_out=carried_out):
            self._rung = None
            return None
        waited_ms = at_ms - self._since_ms
        failed = waited_ms > ESCALATE_MS
        if self._rung is StopMeans.REGISTERS and waited_ms > OBEYS_MS:
            failed = failed or not heard or newest.speed_rad_s >= self._speed
        if self._rung is StopMeans.PROGRAM and heard:
            failed = failed or newest.state is None or newest.state.safety_mode not in SAFE_MODES
        if not failed:
            return None
        self._take(_ORDER[min(_ORDER.index(self._rung) + 1, len(_ORDER) - 1)], newest, at_ms)
        return self._rung

    def _done(self, newest: Package, *, carried_out: bool) -> bool:
        # A stop by register leaves the script running, and its threads until it has carried the stop out.
        # A paused program is not ended: a person could let it go on.
        return carried_out if self._rung is StopMeans.REGISTERS else newest.runtime_state == STOPPED

    def _take(self, rung: StopMeans, newest: Package, at_ms: int) -> None:
        self._rung, self._since_ms = rung, at_ms
        self._speed = newest.speed_rad_s


_ORDER: Final = (StopMeans.REGISTERS, StopMeans.PROGRAM, StopMeans.DASHBOARD)

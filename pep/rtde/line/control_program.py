"""Life of the control script in a lease: sent when harmless, running once its watchdog is armed.

    none -> waiting: for no program, and no command -> sent -> arming: the watchdog -> clearing: that -> running

The script acts on the command that it reads first, even an old one: so it is not sent before the controller itself says
that none stands. It is over when the controller tells of any program's start or end after its own start: while the arm
stands a program takes the place of another from one package to the next. Pure: the controller's state and the time are
arguments, the next step is the result.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Final

from pep.rtde.line.lease_stop import PLAYING, STOPPED
from pep.rtde.line.script_terms import DONE, READY
from pep.rtde.robot.program import OURS, STARTED

if TYPE_CHECKING:
    from pep.rtde.robot.state_receiver import Package
    from pep.rtde.script.control_script import Upload
    from pep.rtde.wire.primary_frames import Key

ARM: Final = 35
"""Command id of the watchdog."""
WAIT_MS: Final = 2_000
"""Longest wait for the end of the program before it; ur_rtde has told it to end."""
START_MS: Final = 4_000
"""Longest start; ur_rtde waits for 5 s."""


class Phase(Enum):
    """Phase of the script's life."""

    NONE = "none"
    WAITING = "waiting"
    SENT = "sent"
    ARMING = "arming"
    CLEARING = "clearing"
    RUNNING = "running"


class ControlStep(Enum):
    """Step to be taken."""

    SEND = "send"
    """Send the script to the controller."""
    ARM = "arm"
    """Set its watchdog."""
    CLEAR = "clear"
    """Clear the command of the watchdog."""
    BEGIN = "begin"
    """Let the program command."""
    FAIL = "fail"
    """Fail: the script did not come so far in time."""
    END = "end"
    """End: the script runs no longer."""


class ControlProgram:
    """Control script of one lease."""

    def __init__(self) -> None:
        self.phase = Phase.NONE
        self.upload: Upload | None = None
        self._since_ms = 0
        self._begun = False  # the controller has told of its start
        self._disturbed = False  # and of another event since

    @property
    def starting(self) -> bool:
        """True while the script is on its way."""
        return self.phase not in (Phase.NONE, Phase.RUNNING)

    @property
    def sent(self) -> bool:
        """True once the controller has the script."""
        return self.phase not in (Phase.NONE, Phase.WAITING)

    def begin(self, upload: Upload, *, at_ms: int) -> None:
        """Begins with an uploaded script; the earlier one is over."""
        self.upload = upload
        self._go(Phase.WAITING, at_ms)

    def end(self) -> None:
        """Ends the script."""
        self.phase, self.upload = Phase.NONE, None

    def told(self, event: Key) -> None:
        """Takes in a start or end of a program. Events before the script's own start are of other programs."""
        self._disturbed = self._disturbed or self._begun
        self._begun = self._begun or (self.sent and event.title == STARTED and event.text == OURS)

    def unheard(self) -> None:
        """Notes that an event of the controller may have been missed."""
        self._disturbed = self.sent

    def look(self, package: Package, *, at_ms: int) -> ControlStep | None:
        """Step after the newest package, or None."""
        if self.upload is None:
            return None
        command, said = package.registers[self.upload.script.offset]
        playing = package.runtime_state == PLAYING and not self._disturbed
        turn: ControlStep | None = None
        match self.phase:
            case Phase.WAITING if package.runtime_state == STOPPED and command == 0:
                self._begun = self._disturbed = False
                turn = self._go(Phase.SENT, at_ms, ControlStep.SEND)
            # Only a script that has been idle is seen to have done something: the last one's word may still stand.
            case Phase.SENT if playing and said == READY:
                turn = self._go(Phase.ARMING, at_ms, ControlStep.ARM)
            case Phase.ARMING if playing and command == ARM and said == DONE:
                turn = self._go(Phase.CLEARING, at_ms, ControlStep.CLEAR)
            case Phase.CLEARING if playing and self._begun and command == 0 and said == READY:
                turn = self._go(Phase.RUNNING, at_ms, ControlStep.BEGIN)
            case Phase.ARMING | Phase.CLEARING if not playing:
                self.end()
                turn = ControlStep.FAIL
            case Phase.RUNNING if not playing:
                self.end()
                turn = ControlStep.END
            case _:
                turn = self.late(at_ms=at_ms)
        return turn

    def late(self, *, at_ms: int) -> ControlStep | None:
        """Step after too long a time, or None."""
        limit_ms = WAIT_MS if self.phase is Phase.WAITING else START_MS
        if self.starting and at_ms - self._since_ms > limit_ms:
            self.end()
            return ControlStep.FAIL
        return None

    def _go(self, phase: Phase, at_ms: int, turn: ControlStep | None = None) -> ControlStep | None:
        self.phase, self._since_ms = phase, at_ms
        return turn

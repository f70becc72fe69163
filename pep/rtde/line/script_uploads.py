"""Programs of a lease's holder on a script port: ur_rtde's control script, or a program that only stops.

Bytes in. Nothing of them is kept but the numbers of a path: the sent program is written from our own copy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.rtde.line.gateway import MAX_STOP, only_stops
from pep.rtde.script.control_script import Recogniser, Upload
from pep.rtde.script.urscript import ProgramStream, ScriptError
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.rtde.script.control_script import ControlScript


class OnlyStops:
    """Program that only stops the arm."""


ONLY_STOPS: Final = OnlyStops()


class LeasedScripts:
    """Programs of one connection.

    Args:
        scripts: control scripts for this controller.
    """

    def __init__(self, scripts: Sequence[ControlScript]) -> None:
        self._scripts = scripts
        self._recogniser = Recogniser(scripts)
        self._beginning = bytearray()  # of the program, for as long as it may be one that only stops
        self._others: ProgramStream | None = None

    def feed(self, received: bytes) -> list[Upload | OnlyStops] | InputRefusal:
        """Programs completed by `received`; any other is refused as soon as it is known."""
        if self._others is not None:
            return self._stops(received)
        found = self._recogniser.feed(received)
        if isinstance(found, Upload):
            self._recogniser = Recogniser(self._scripts)
            self._beginning.clear()
            return [found]
        if len(self._beginning) <= MAX_STOP:
            self._beginning += received
        if isinstance(found, InputRefusal):
            if len(self._beginning) > MAX_STOP:
                return found
            # No control script begins so: from here on the connection is one for stops.
            self._others = ProgramStream(MAX_STOP)
            return self._stops(bytes(self._beginning))
        return []

    def _stops(self, received: bytes) -> list[Upload | OnlyStops] | InputRefusal:
        assert self._others is not None
        try:
            programs = self._others.feed(received.decode("ascii"))
        except (ScriptError, UnicodeDecodeError):
            return InputRefusal(Reason.BODY_MALFORMED, "program")
        if not all(map(only_stops, programs)):
            return InputRefusal(Reason.NOT_GRANTED, "no script of a program's own is")
        return [ONLY_STOPS] * len(programs)

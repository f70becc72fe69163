"""Rhythm of the questions about a stream whose value was refused, while its program goes on with others.

ur_rtde does not wait for what becomes of a value, so no answer reaches the program; its next value is asked about as
the first one was. A program that goes on regardless is a question four times a second, and not five hundred.
"""

from __future__ import annotations

from typing import Final

from pep.rtde.command.command_table import ROWS, Wait
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

UNWAITED: Final = frozenset(row.id for row in ROWS.values() if row.id and row.wait is Wait.AT_ONCE)
"""Commands after which ur_rtde goes on at once."""
FOLLOWS: Final = InputRefusal(Reason.NOT_WHAT_WAS_DECIDED, "no other value may follow")
PAUSE_MS: Final = 250
"""Ours: time between two questions about one refused stream, from the second refusal in a row on."""


class RefusedStream:
    """Command of a stream that was refused, by its id; 0 while there is none."""

    def __init__(self) -> None:
        self.command = 0
        self._next_ms = 0

    def refused(self, command: int, *, asked_ms: int) -> None:
        """Notes that its value was refused; `asked_ms` is the monotonic time of the question."""
        self._next_ms = asked_ms + PAUSE_MS if self.command == command else asked_ms
        self.command = command

    def over(self) -> None:
        """Notes that it was permitted, or that its program has turned to another command."""
        self.command = 0

    def turns(self, command: int, before: int) -> int:
        """Command that the script has before this one: 0 for one that was refused. Another one ends the stream."""
        before = 0 if before == self.command else before
        if command != self.command:
            self.over()
        return before

    def due(self, command: int, *, at_ms: int) -> bool:
        """True where that command's value is to be asked about now."""
        return command != self.command or at_ms >= self._next_ms

"""Lag of the controller behind the ids that were written to its command register.

The controller's report of that register is some milliseconds old: a register that "is" 0 may be about to get a command,
and one that has a command may have had the same one before. Ids go out in an order, and come back in that order; some
of them are overwritten before the controller looks.
"""

from __future__ import annotations

from collections import deque
from typing import Final

QUIET: Final = 50
"""Equal packages (0.1 s) after which every earlier unreported id was overwritten."""
MOST: Final = 32
"""Most ids that are followed one by one."""


class RegisterEcho:
    """Command ids that were written, and those that came back."""

    def __init__(self) -> None:
        self._told = 0  # came back last
        self._ahead: deque[int] = deque()  # were written after it, each other than the one before
        self._followed = True
        self._same = 0

    @property
    def newest(self) -> bool:
        """True where the controller has the id that was written last, and not only an earlier equal one."""
        return not self._ahead

    @property
    def ending(self) -> bool:
        """True where the controller lacks nothing that was written, or only the last clear."""
        return not self._ahead or (self._followed and list(self._ahead) == [0])

    def wrote(self, command: int) -> None:
        """Notes that the id was written."""
        self._same = 0
        if command != (self._ahead[-1] if self._ahead else self._told):
            self._ahead.append(command)
            if len(self._ahead) > MOST:
                self._followed = False  # which of them it is that comes back cannot be told any more
                self._ahead.popleft()

    def told(self, command: int) -> None:
        """Notes that the controller reports the id."""
        if not self._ahead:
            return
        self._same = self._same + 1 if command == self._ahead[-1] else 0
        if self._same > QUIET:
            self._told, self._followed = command, True
            self._ahead.clear()
        elif self._followed and command != self._told and command in self._ahead:
            # The earliest that it can be.
            while self._ahead.popleft() != command:
                pass
            self._told = command

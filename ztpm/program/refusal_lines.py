"""Lines on the standard error of a program's caller about refusals of the gateway.

    ztpm: NOT_GRANTED: The token does not grant this operation. (no operation stands for it)
    ztpm: BUSY: moveJ: the command before is not over (12 more)

The program itself sees that a call has failed, and nothing else. A line is there at once, and the same one not again
within a second: repetitions are counted in the next. The lines are written by a thread of their own, since their reader
may be slow, and a lease does not wait.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

from capabilities.values.characters import shown

if TYPE_CHECKING:
    from collections.abc import Callable

NAME: Final = "ztpm"
SECOND_S: Final = 1.0
"""Seconds before a line is repeated."""
DIFFERENT: Final = 16
"""Different texts in a second; further ones are counted together."""
OTHERS: Final = "other reasons"
WAITING: Final = 256
"""Texts that wait for the thread; with no reader of its output, further ones are lost."""
LAST_S: Final = 0.5
"""Longest wait for the last lines: their reader may have stopped."""
STANDARD_ERROR: Final = 2


@dataclass(slots=True)
class _Told:
    """Text, with the time of its last line, and its count since."""

    at_s: float
    more: int


class Repeats:
    """Schedule of the lines. Pure: time is an argument, in monotonic seconds."""

    def __init__(self) -> None:
        self._texts: dict[str, _Told] = {}

    def told(self, text: str, *, at_s: float) -> list[str]:
        """Lines due now that this text has come; spelled as `shown` does."""
        lines = self.due(at_s=at_s)
        text = shown(text)
        if text not in self._texts and len(self._texts) >= DIFFERENT:
            self._texts.setdefault(OTHERS, _Told(at_s, 0)).more += 1
        elif text in self._texts:
            self._texts[text].more += 1
        else:
            self._texts[text] = _Told(at_s, 0)
            lines.append(f"{NAME}: {text}")
        return lines

    def due(self, *, at_s: float) -> list[str]:
        """Lines due now that time has passed."""
        lines = []
        for text, told in tuple(self._texts.items()):
            if at_s - told.at_s < SECOND_S:
                continue
            if told.more:
                lines.append(_counted(text, told.more))
                self._texts[text] = _Told(at_s, 0)
            else:
                del self._texts[text]
        return lines

    def rest(self) -> list[str]:
        """Lines not written yet; no text comes any more."""
        return [_counted(text, told.more) for text, told in self._texts.items() if told.more]

    @property
    def next_s(self) -> float | None:
        """Time of the next due line; None while there is none."""
        return min((told.at_s + SECOND_S for told in self._texts.values() if told.more), default=None)


def _counted(text: str, more: int) -> str:
    return f"{NAME}: {text} ({more} more)"


class RefusalLines:
    """Writer of the lines, from its entry until its exit.

    Args:
        write: a line; it may wait.
    """

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._texts: queue.Queue[str | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._say, name="told", daemon=True)

    def __enter__(self) -> Self:
        """Starts the writer (see the class)."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Writes the lines so far, unless no reader takes them."""
        with suppress(queue.Full):
            self._texts.put(None, timeout=LAST_S)
            self._thread.join(LAST_S)

    def tell(self, text: str) -> None:
        """Writes or counts the text. Returns at once."""
        with suppress(queue.Full):
            self._texts.put_nowait(text)

    def _say(self) -> None:
        repeats = Repeats()
        while True:
            next_s = repeats.next_s
            wait_s = None if next_s is None else max(0.0, next_s - time.monotonic())
            text: str | None = ""
            with suppress(queue.Empty):
                text = self._texts.get(timeout=wait_s)
            at_s = time.monotonic()
            if text is None:
                self._all(repeats.rest())
                return
            self._all(repeats.told(text, at_s=at_s) if text else repeats.due(at_s=at_s))

    def _all(self, lines: list[str]) -> None:
        for line in lines:
            self._write(line)


def on_standard_error(line: str) -> None:
    """Writes the line, unless standard error is gone. No buffer: the program writes there, too."""
    with suppress(OSError):
        os.write(STANDARD_ERROR, f"{line}\n".encode())

"""Progress of long work on standard error: one line that changes on a terminal, elsewhere a line every few seconds."""

from __future__ import annotations

import sys
import threading
import time
from contextlib import contextmanager, suppress
from typing import IO, TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LOOK_S: Final = 0.2
EACH_S: Final = 3.0  # ours: so no command is silent for more than five seconds
LESS_S: Final = 0.5  # ours: so much later comes what tells less
WIPED: Final = "\r\x1b[K"  # ECMA-48: to the start of the line, which is then empty


class Preparing:
    """Tells how far something is, and leaves a terminal as it was.

    Args:
        stream: standard error by default.
        clock: monotonic seconds.
    """

    def __init__(self, stream: IO[str] | None = None, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._given = stream
        self._clock = clock
        self._last_s: float | None = None
        self._newer: object = None  # than what is shown
        self._line = False  # on a terminal, which is not free

    def tell(self, progress: object) -> None:
        """Shows the progress; not on a terminal, only once in `EACH_S` seconds."""
        now = self._clock()
        if self._changes:
            self._change(str(progress))
        elif self._last_s is not None and now - self._last_s < EACH_S:
            self._newer = progress
            return
        else:
            self._write(f"{progress}\n")
        self._last_s, self._newer = now, None

    def wait(self, progress: object, *, after_s: float = EACH_S) -> None:
        """Shows the latest progress that was told, or else this, once nothing was shown for so long.

        Args:
            progress: of those who tell none.
            after_s: so long, seconds; `EACH_S` at least.
        """
        now = self._clock()
        if self._last_s is None:
            self._last_s = now
        elif now - self._last_s >= after_s:
            self.tell(progress if self._newer is None else self._newer)

    def over(self) -> None:
        """Frees a terminal's line."""
        if self._line:
            self._write(WIPED)
        self._line, self._newer = False, None

    @property
    def _changes(self) -> bool:
        """True where one line changes."""
        return self._stream.isatty()

    def _change(self, text: str) -> None:
        """Changes that line."""
        self._write(f"{WIPED}{text}")
        self._line = True

    @property
    def _stream(self) -> IO[str]:
        return sys.stderr if self._given is None else self._given

    def _write(self, text: str) -> None:
        with suppress(OSError):  # it has no reader any more
            self._stream.write(text)
            self._stream.flush()


SHOWN: Final = Preparing()
"""The display of this process: what it waits for follows one another without a gap."""


@contextmanager
def waiting(what: str, shown: Preparing = SHOWN, *, at_once: bool = False) -> Iterator[Callable[[], None]]:
    """Shows how long the block takes, once in a few seconds, where nothing else is shown.

    Args:
        what: takes so long.
        shown: the display.
        at_once: also when it begins, where it is known to take long.

    Yields:
        The end of it, where that comes before the end of the block.
    """
    began, over = time.monotonic(), threading.Event()

    def look() -> None:
        while not over.wait(LOOK_S):
            shown.wait(f"{what}, {time.monotonic() - began:.0f} s", after_s=EACH_S + LESS_S)

    def end() -> None:
        over.set()
        looking.join()
        shown.over()

    if at_once:
        shown.tell(what)
    looking = threading.Thread(target=look, daemon=True)
    looking.start()
    try:
        yield end
    finally:
        end()


def prepare_physics() -> None:
    """Compiles the kernel of the physics: a minute the very first time, later a second."""
    with waiting("loading the physics"):
        from pep.pit.assessment.readiness import compile_telling

        compile_telling(SHOWN.tell)

"""Progress of long work on standard error: one line that changes on a terminal, elsewhere a line every few seconds."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

EACH_S: Final = 4.0  # ours: so no command is silent for more than five seconds
WIPED: Final = "\r\x1b[K"  # ECMA-48: to the start of the line, which is then empty


class Preparing:
    """Tells how far something is, and leaves a terminal as it was.

    Args:
        stream: standard error by default.
        clock: monotonic seconds.
    """

    def __init__(self, stream: IO[str] | None = None, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._clock = clock
        self._last_s: float | None = None

    def tell(self, progress: object) -> None:
        """Shows the progress; not on a terminal, only once in `EACH_S` seconds."""
        now = self._clock()
        if self._stream.isatty():
            self._write(f"{WIPED}{progress}")
        elif self._last_s is not None and now - self._last_s < EACH_S:
            return
        else:
            self._write(f"{progress}\n")
        self._last_s = now

    def over(self) -> None:
        """Ends the display, and frees a terminal's line."""
        if self._last_s is not None and self._stream.isatty():
            self._write(WIPED)
        self._last_s = None

    def _write(self, text: str) -> None:
        with suppress(OSError):  # it has no reader any more
            self._stream.write(text)
            self._stream.flush()


def prepare_physics() -> None:
    """Compiles the kernel of the physics: minutes the very first time, later a second."""
    from pep.pit.assessment.readiness import compile_telling

    shown = Preparing()
    try:
        compile_telling(shown.tell)
    finally:
        shown.over()

"""Log in which equal lines are told once a minute, with their number."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

PERIOD_S: Final = 60.0
KINDS: Final = 64
"""Different lines told apart within one period; the others of a logger and level count as equal."""
LINE: Final = 256
"""Characters by which lines are told apart."""


class OnceAMinute(logging.Filter):
    """Filter that lets the first of equal lines through, and the next only a minute later.

    Args:
        now: monotonic clock, seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now = now
        self._told: dict[tuple[str, int, str], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """True where the line is told; it then says how many were not."""
        now = self._now()
        kind = (record.name, record.levelno, record.getMessage()[:LINE])
        if kind not in self._told and len(self._told) >= KINDS:
            self._forget(now)
            if len(self._told) >= KINDS:
                kind = (record.name, record.levelno, "")
        told_s, more = self._told.get(kind, (now - PERIOD_S, 0))
        if now - told_s < PERIOD_S:
            self._told[kind] = (told_s, more + 1)
            return False
        self._told[kind] = (now, 0)
        if more:
            record.msg, record.args = f"{record.getMessage()} (and {more} more like it)", ()
        return True

    def _forget(self, now: float) -> None:
        self._told = {kind: told for kind, told in self._told.items() if now - told[0] < PERIOD_S}

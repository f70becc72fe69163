"""Word of a campaign on how far it is, so that nobody takes work for a standstill."""

from __future__ import annotations

import sys
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PERIOD_S = 4.0
"""Time between two words."""


class Progress:
    """Says on standard error how far the work is, once in a period."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def at(self, how_far: str) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + PERIOD_S
            print(how_far, file=sys.stderr, flush=True)


@contextmanager
def telling(how_far: Callable[[], str]) -> Iterator[None]:
    """While it lasts, a thread says how far the work is, also while the work waits."""
    over, began_s = threading.Event(), time.monotonic()

    def tell() -> None:
        while not over.wait(PERIOD_S):
            print(f"{time.monotonic() - began_s:.0f} s: {how_far()}", file=sys.stderr, flush=True)

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

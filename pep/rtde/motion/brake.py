"""One way to stop that may block, on a thread of its own, so that its caller never waits."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Brake:
    """One way to stop, given again and again, at most once at a time. From any thread.

    Args:
        name: of its thread.
        give: gives the stop; it may block, and fail.
    """

    def __init__(self, name: str, give: Callable[[], None]) -> None:
        self._name = name
        self._give = give
        self._lock = threading.Lock()
        self._given: Future[None] | None = None

    def take(self) -> Future[None]:
        """Gives the stop, unless it is being given; returns the future of its end."""
        with self._lock:
            if self._given is None or self._given.done():
                self._given = Future()
                threading.Thread(target=self._run, args=(self._given,), name=self._name, daemon=True).start()
            return self._given

    def _run(self, given: Future[None]) -> None:
        try:
            self._give()
        except BaseException as error:  # noqa: BLE001 - a stop that failed is judged by the arm, which is watched
            given.set_exception(error)
        else:
            given.set_result(None)

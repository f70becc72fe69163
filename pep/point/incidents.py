"""Incidents beside requests, told on standard error, since no caller waits for an answer about them."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any, Final

from pep.base.errors import PepError

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from pep.base.ports import Clock

TOLD_EACH_MS: Final = 60_000
"""Period in which a repeated incident of one kind is told once."""
_LOG: Final = logging.getLogger("ztpm.point.enforcement_point")


class Incidents:
    """Incidents, each kind told once a minute.

    Args:
        clock: clock for the minute.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._told: dict[tuple[str, str], int] = {}
        self._tasks: set[asyncio.Task[object]] = set()

    def watched(self, what: str, work: Coroutine[Any, Any, object]) -> asyncio.Task[object]:
        """Task that does the work from here on, kept until it ends; its failure is told."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(lambda task: None if task.cancelled() else self.tell(what, task.exception()))
        return task

    def tell(self, what: str, error: BaseException | None) -> None:
        """Tells an incident; None is none.

        An error that has no code of ours is told by type and place: its message may hold a caller's text.
        """
        if error is None:
            return
        name = type(error).__name__
        kind, told, where = (error.code, str(error), None) if isinstance(error, PepError) else (name, name, error)
        if self.first(what, kind):
            _LOG.warning("%s: %s", what, told, exc_info=where)

    def first(self, what: str, kind: str) -> bool:
        """True where no incident of this kind was told lately, and from now on one was."""
        now = self._clock.monotonic_ms()
        if now - self._told.get((what, kind), now - TOLD_EACH_MS) < TOLD_EACH_MS:
            return False
        self._told[what, kind] = now
        return True

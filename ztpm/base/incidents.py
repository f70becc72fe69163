"""What goes wrong beside requests, told on standard error: nobody waits for an answer that could say so."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any, Final

from pep.base.errors import PepError

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from pep.base.ports import Clock

TOLD_EACH_MS: Final = 60_000
"""What goes wrong again and again is told once in so long for each kind."""
_LOG: Final = logging.getLogger("ztpm.point.enforcement_point")


class Incidents:
    """What went wrong, once a minute for each kind.

    Args:
        clock: by which a minute passes.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._told: dict[tuple[str, str], int] = {}
        self._tasks: set[asyncio.Task[object]] = set()

    def watched(self, what: str, work: Coroutine[Any, Any, object]) -> asyncio.Task[object]:
        """A task that does it from here on, and is kept until it ends; why it failed is told."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(lambda task: None if task.cancelled() else self.tell(what, task.exception()))
        return task

    def tell(self, what: str, error: BaseException | None) -> None:
        """What went wrong, and where, unless it has a code of ours; None: nothing did."""
        if error is None:
            return
        kind, where = (error.code, None) if isinstance(error, PepError) else (type(error).__name__, error)
        if self.first(what, kind):
            _LOG.warning("%s: %s", what, error, exc_info=where)

    def first(self, what: str, kind: str) -> bool:
        """Whether nothing of this kind was told lately. It has been, from now on."""
        now = self._clock.monotonic_ms()
        if now - self._told.get((what, kind), now - TOLD_EACH_MS) < TOLD_EACH_MS:
            return False
        self._told[what, kind] = now
        return True

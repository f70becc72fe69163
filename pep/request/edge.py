"""Leases and records of an enforcement point, which it needs before any decision."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final

from policies.decision.policy import requirement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.base.ports import Journal
    from policies.decision.policy import PolicySet
    from policies.evidence.model import Request

SETTLED_S: Final = 0.1
"""Ours: longest time for which a note waits to be durable, seconds."""


class Edge:
    """Leases of the policies and records in the journal, which a worker of their own writes one after the other.

    Args:
        policies: the policies of decisions.
        journal: durable.
    """

    def __init__(self, *, policies: PolicySet, journal: Journal) -> None:
        self._policies = policies
        self._journal = journal
        # A worker, so that nothing else delays a record, and a record no stop (which has its own way in the shell).
        self._recorder = ThreadPoolExecutor(1, "journal")
        self._settling: asyncio.TimerHandle | None = None

    def lease_ms(self, request: Request | None) -> int:
        """Oldest acceptable revocation view in ms, for a request, or (None) for a call without operation."""
        if request is None:
            return self._policies.parameters.lease_other_ms
        return requirement(request, self._policies).lease_ms

    async def record(self, kind: str, body: dict[str, object]) -> str:
        """Makes a durable record of a decision or another event of the shell; its hash.

        Raises:
            JournalError: when it cannot be one: the caller then has no effect to give.
        """
        return await asyncio.get_running_loop().run_in_executor(self._recorder, self._journal.append, kind, body)

    async def record_all(self, kind: str, bodies: Sequence[dict[str, object]]) -> None:
        """Makes durable records of one kind, in order, with one sync.

        Raises:
            JournalError: when one cannot be one; none of them counts then.
        """

        def write() -> None:
            for body in bodies[:-1]:
                self._journal.note(kind, body)
            for body in bodies[-1:]:
                self._journal.append(kind, body)

        await asyncio.get_running_loop().run_in_executor(self._recorder, write)

    def note(self, kind: str, body: dict[str, object]) -> None:
        """Writes a record of something that has happened; it is durable with the next one, or `SETTLED_S` later.

        Raises:
            JournalError: when it cannot be written.
        """
        self._journal.note(kind, body)
        if self._settling is None:
            self._settling = asyncio.get_running_loop().call_later(SETTLED_S, self._settle)

    def _settle(self) -> None:
        self._settling = None
        # A failure is the journal's own state: it denies every later effect by itself.
        self._recorder.submit(self._journal.settle)

    def close(self) -> None:
        """Everything that was to be recorded is, and the worker has ended."""
        if self._settling is not None:
            self._settling.cancel()
        self._recorder.shutdown(wait=True)

"""Joint work: commands that wait at once are done in one transaction, each of them decided by itself.

Nothing is answered before the commit. Where the transaction does not hold, nothing of it does, and each of its commands
is done again in a transaction of its own, as one that came alone is.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from capabilities.values.errors import CapabilityError
from ztpm_idp.domain.joint import apart
from ztpm_idp.store import AgainError, ConflictError, LocksTooFewError, OnceOnlyError
from ztpm_idp.store.asking import gathered

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from ztpm_idp.domain.commands import Command
    from ztpm_idp.domain.locks import Locks
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.state import Wanted
    from ztpm_idp.provider.done import Done, OneUse


@dataclass(eq=False, slots=True)
class Work:
    """One command that waits to be done.

    Attributes:
        command, needed, locks, actor, once: as of `Provider.run`.
        trace_id: of the request that it came with.
        claim: locks by which it is told apart from others.
        result: outcome and what was done, or the error; durable.
    """

    command: Command
    needed: Wanted
    locks: Locks
    claim: Locks
    actor: str
    once: OneUse | None
    trace_id: str | None
    result: asyncio.Future[tuple[Outcome, Done | None]] = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )

    def did(self, outcome: tuple[Outcome, Done | None]) -> None:
        """Answers, unless nobody waits any more."""
        if not self.result.done():
            self.result.set_result(outcome)

    def failed(self, error: BaseException) -> None:
        """Answers with an error, likewise."""
        if not self.result.done():
            self.result.set_exception(error)


Outcomes = dict[Work, "tuple[Outcome, Done | None] | Exception"]
"""Of each command of a transaction that holds; `LocksTooFewError` for one that is to be done alone after all."""
APART: Final = (CapabilityError, OnceOnlyError, ConflictError, AgainError, LocksTooFewError)
"""Errors by which a transaction of several certainly did not hold, and that one of its commands may have made."""


class JointWork:
    """Queue of commands of one sort.

    Args:
        together: does several in one transaction.
        alone: does one.
        at_once: transactions at a time.
    """

    def __init__(
        self,
        together: Callable[[Sequence[Work]], Awaitable[Outcomes]],
        alone: Callable[[Work], Awaitable[tuple[Outcome, Done | None]]],
        *,
        at_once: int,
    ) -> None:
        self._together = together
        self._alone = alone
        self._at_once = at_once
        self._waiting = deque[Work]()
        self._tasks = set[asyncio.Task[None]]()
        self._working = 0

    async def done(self, work: Work) -> tuple[Outcome, Done | None]:
        """The outcome of a command, and what it has done, durably.

        Raises: what doing it alone would.
        """
        self._waiting.append(work)
        if self._working < self._at_once:
            self._working += 1
            task = asyncio.create_task(self._work())
            self._tasks.add(task)  # nobody else holds it
            task.add_done_callback(self._tasks.discard)
        return await work.result

    async def _work(self) -> None:
        try:
            await self._until_none_waits()
        finally:
            # At once, not when the loop has seen the task's end: what comes in between would wait for nobody.
            self._working -= 1

    async def _until_none_waits(self) -> None:
        while self._waiting:
            await gathered(self._waiting)
            places = apart([work.claim for work in self._waiting])
            taken = [self._waiting[place] for place in places]
            self._waiting = deque(work for work in self._waiting if work not in taken)
            if taken:
                await self._do(taken)

    async def _do(self, taken: Sequence[Work]) -> None:
        again = list(taken)
        if len(taken) > 1:
            try:
                outcomes = await self._together(taken)
            except APART:
                pass  # each alone
            except BaseException as error:
                for work in taken:
                    work.failed(error)
                if not isinstance(error, Exception):
                    raise
                return
            else:
                again = [work for work in taken if isinstance(outcomes[work], LocksTooFewError)]
                for work, outcome in outcomes.items():
                    match outcome:
                        case LocksTooFewError():
                            pass
                        case Exception():
                            work.failed(outcome)
                        case _:
                            work.did(outcome)
        for work in again:
            try:
                work.did(await self._alone(work))
            except BaseException as error:
                work.failed(error)
                if not isinstance(error, Exception):
                    raise

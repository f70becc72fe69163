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
STILL_S: Final = 0.1
"""Seconds after which a transaction stands still: many times as long as one takes that waits for nobody."""
APART: Final = (CapabilityError, OnceOnlyError, ConflictError, AgainError, LocksTooFewError)
"""Errors by which a transaction of several certainly did not hold, and that one of its commands may have made."""


class JointWork:
    """Queue of commands of one sort: one transaction at a time, of all that wait when it begins.

    More of them would be smaller, and each costs the same trips. Only while one stands still, as it does when it waits
    for another process, others go on beside it.

    Args:
        together: does those that wait in one transaction.
        alone: does one.
        at_once: transactions at a time, those that stand still among them.
        still_s: seconds after which a transaction stands still.
    """

    def __init__(
        self,
        together: Callable[[Sequence[Work]], Awaitable[Outcomes]],
        alone: Callable[[Work], Awaitable[tuple[Outcome, Done | None]]],
        *,
        at_once: int,
        still_s: float = STILL_S,
    ) -> None:
        self._together = together
        self._alone = alone
        self._at_once = at_once
        self._still_s = still_s
        self._waiting = deque[Work]()
        self._began = dict[asyncio.Task[None], float]()
        self._watch: asyncio.TimerHandle | None = None

    async def done(self, work: Work) -> tuple[Outcome, Done | None]:
        """The outcome of a command, and what it has done, durably.

        Raises: what doing it alone would.
        """
        self._waiting.append(work)
        self._go_on()
        return await work.result

    def _go_on(self) -> None:
        """Waiting commands are being done, or will be as soon as all transactions stand still."""
        if not self._waiting or len(self._began) == self._at_once:
            return
        loop = asyncio.get_running_loop()
        begins_s = max(self._began.values(), default=-self._still_s) + self._still_s
        if not self._began or begins_s <= loop.time():
            self._began[loop.create_task(self._work())] = loop.time()
        elif self._watch is None:
            self._watch = loop.call_at(begins_s, self._watched)

    def _watched(self) -> None:
        self._watch = None
        self._go_on()

    async def _work(self) -> None:
        me = asyncio.current_task()
        assert me is not None
        try:
            # Beside another one it does but what waited while that one stood still.
            while self._waiting:
                self._began[me] = asyncio.get_running_loop().time()
                await self._next()
                if len(self._began) > 1:
                    break
        finally:
            # At once, not when the loop has seen the task's end: what comes in between would wait for nobody.
            del self._began[me]
            self._go_on()

    async def _next(self) -> None:
        await gathered(self._waiting)
        places = apart([work.claim for work in self._waiting])
        taken = [self._waiting[place] for place in places]
        self._waiting = deque(work for work in self._waiting if work not in taken)
        if taken:
            await self._do(taken)

    async def _do(self, taken: Sequence[Work]) -> None:
        # Also one that came alone: what it is decided on is read in as few trips.
        again = list(taken)
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

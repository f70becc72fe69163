"""Waiting for the revocation epoch to grow: a hint for enforcement points, which then pull the signed index.

The hint carries no signature and no authority. Forged or lost, it can cause a pull or leave the next ordinary one to
find out; it can never make a view young, and never makes a revocation wait longer than a pull period.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider.problems import Problem

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine

LONGEST_S: Final = 20.0
"""Longest wait for one answer: below the 30 s after which common proxies drop a silent request."""
APART_S: Final = 0.02
"""Least time between two hints: each is a pull of every enforcement point, and what is revoked meanwhile shares one.

The first after a quiet time is told at once; a later one waits so long at most.
"""
WAITERS: Final = 256
"""Requests that may wait at a time. Each holds a connection; the endpoint asks nobody who they are."""


class EpochWait:
    """Requests that wait for a higher epoch.

    It is told of every commit of this process. With several processes over one store, a revocation made by another one
    is found when the wait ends by time; until then the pull, four times a second, is what finds it. A notification of
    the database (PostgreSQL's LISTEN and NOTIFY) would call `told` from a task that starts beside this object.

    Args:
        epoch: the store's epoch now.
        longest_s: longest wait.
        most: requests that may wait at a time.
        apart_s: least time between two hints.
    """

    def __init__(
        self,
        epoch: Callable[[], Awaitable[int]],
        *,
        longest_s: float = LONGEST_S,
        most: int = WAITERS,
        apart_s: float = APART_S,
    ) -> None:
        self._epoch = epoch
        self._longest_s = longest_s
        self._most = most
        self._grown = asyncio.Event()
        self._highest = 0
        self._waiting = 0
        self._closed = False
        self._apart_s = apart_s
        self._hinted = 0  # the highest epoch of which those who waited were told
        self._pause: asyncio.TimerHandle | None = None

    @property
    def highest(self) -> int:
        """The highest epoch that it was told of; the store's own may be higher."""
        return self._highest

    def told(self, epoch: int) -> None:
        """The store's epoch is at least this: committed, not merely tried."""
        if epoch > self._highest:
            self._highest = epoch
            if self._pause is None:
                self._hint()

    def close(self) -> None:
        """Ends the service: every waiting caller is answered now, and none waits any more."""
        self._closed = True
        if self._pause is not None:
            self._pause.cancel()
        self._wake()

    async def above(
        self, since: int, *, gone: Callable[[], Coroutine[None, None, None]], longest_s: float | None = None
    ) -> int:
        """The epoch, as soon as it is above `since`, and at the latest after the longest wait.

        Args:
            since: the epoch that the caller knows.
            gone: a task that ends when the caller has hung up, and so ends the wait.
            longest_s: longest wait in place of the ordinary one.

        Raises:
            Problem: `TOO_MANY_WAITERS`.
            StoreUnavailableError: the store cannot be read.
        """
        self.check_place()
        self._waiting += 1
        left = asyncio.create_task(gone())
        try:
            # Taken before the store is asked: a commit after the answer sets this very event.
            grown = self._grown
            epoch = await self._epoch()
            self.told(epoch)  # another process may have made it, and its hint be lost
            if self._closed or (epoch > since and (self._pause is None or self._hinted > since)):
                return epoch
            grew = asyncio.create_task(grown.wait())
            try:
                longest_s = self._longest_s if longest_s is None else longest_s
                await asyncio.wait({grew, left}, timeout=longest_s, return_when=asyncio.FIRST_COMPLETED)
            finally:
                grew.cancel()
            return self._highest if self._highest > since else await self._epoch()
        finally:
            left.cancel()
            self._waiting -= 1

    def check_place(self) -> None:
        """Checks that one more may wait.

        Raises:
            Problem: `TOO_MANY_WAITERS`.
        """
        if self._waiting >= self._most:
            raise Problem(IdpCode.TOO_MANY_WAITERS, f"{self._most} requests are waiting")

    async def growing(self, since: int, *, longest_s: float) -> AsyncIterator[int]:
        """Each epoch above `since` as it comes, the newest alone where several came at once.

        It ends with the service, after `longest_s`, and at once where no place is left.
        """
        until = _now() + longest_s
        while not self._closed and self._waiting < self._most and (left := until - _now()) > 0:
            epoch = await self.above(since, gone=_never, longest_s=min(left, self._longest_s))
            if epoch > since:
                since = epoch
                yield epoch

    def _hint(self) -> None:
        """Tells all who wait, and tells again only after a moment."""
        self._hinted = self._highest
        self._pause = asyncio.get_running_loop().call_later(self._apart_s, self._go_on)
        self._wake()

    def _go_on(self) -> None:
        self._pause = None
        if self._highest > self._hinted and not self._closed:
            self._hint()

    def _wake(self) -> None:
        grown, self._grown = self._grown, asyncio.Event()
        grown.set()


def _now() -> float:
    return asyncio.get_running_loop().time()


async def _never() -> None:
    """Ends never: who listens to events is let go by the server when the connection ends."""
    await asyncio.Event().wait()

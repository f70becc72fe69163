"""Heartbeat: the proof that the store can commit, and the signed words on revocations and conduct that need it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from ztpm_idp.provider import feed
from ztpm_idp.provider.problems import Problem
from ztpm_idp.store.asking import AskedTogether

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.statements import revocation
    from ztpm_idp.provider.feed import Deployment


class Heartbeat:
    """Proof that the store can commit, shared by all who ask at the same time.

    One commit serves all callers that were waiting when it began; nobody is served by a commit that began before it
    asked.

    Attributes:
        beaten_ms: when the newest commit began by the wall clock, milliseconds since the epoch; None before the first.
    """

    def __init__(self, provider: Deployment) -> None:
        self._provider = provider
        self.beaten_ms: int | None = None
        self._turn = asyncio.Lock()
        self._asked = 0
        self._served = 0
        self._pulls = AskedTogether(self._pulled)

    async def beat(self) -> None:
        """A commit that began after this call has succeeded.

        Raises:
            StoreUnavailableError: it has not.
        """
        self._asked += 1
        mine = self._asked
        async with self._turn:
            if self._served >= mine:
                return
            everybody, begun_ms = self._asked, self._provider.now_ms()
            await self._provider.store.beat()
            self._served, self.beaten_ms = everybody, begun_ms

    async def index(self, since: int, base: int | None) -> revocation.RevocationIndex:
        """Index after `since`, of a view that began after this call; one commit and one view serve all who wait.

        Raises: what `revocation_index` does.
        """
        found = await self._pulls.ask((since, base))
        if isinstance(found, Problem):
            raise found
        return found

    async def _pulled(self, asked: Sequence[tuple[int, int | None]]) -> list[revocation.RevocationIndex | Problem]:
        provider, found = self._provider, dict[tuple[int, int | None], "revocation.RevocationIndex | Problem"]()
        as_of_ms = provider.now_ms()
        await self.beat()
        async with provider.store.read() as view:
            await feed.serving(view)
            for since, base in asked:
                if (since, base) in found:
                    continue
                try:
                    index = await feed.unsigned_index(provider, view, since=since, as_of_ms=as_of_ms, base=base)
                    found[since, base] = index
                except Problem as problem:
                    found[since, base] = problem
        return [found[each] for each in asked]


async def revocation_index(
    provider: Deployment, heartbeat: Heartbeat, *, since: int, nonce: str, base: int | None = None
) -> str:
    """Signed index of the revocations after `since`.

    `as_of` is taken first: everything acknowledged before it is in the snapshot. Each epoch has exactly one entry. An
    index that cannot hold all of them brings the oldest; that its last entry is below its epoch says that more is to
    come.

    Args:
        provider: of this deployment.
        heartbeat: of its store.
        since: what the caller knows.
        nonce: echoed.
        base: epoch of the base that the caller began with, 0 for the newest one; None: nothing is left out.

    Raises:
        StoreUnavailableError: the store cannot commit; there is no heartbeat then.
        Problem: `EPOCH_AHEAD` when the caller knows more than the store.
    """
    return feed.signed_index(provider, await heartbeat.index(since, base), nonce=nonce)


async def conduct_word(provider: Deployment, heartbeat: Heartbeat, *, since: int, nonce: str) -> str:
    """Signed word on the changes of agents' conduct after `since`.

    As with revocations, `as_of` is taken first, and a store that cannot commit says nothing. A word that cannot hold
    everything brings the oldest.

    Raises:
        StoreUnavailableError: the store cannot commit.
        Problem: `EPOCH_AHEAD` when the caller knows more than the store.
    """
    as_of_ms = provider.now_ms()
    await heartbeat.beat()
    async with provider.store.read() as view:
        await feed.serving(view)
        return await feed.conduct_of(provider, view, since=since, nonce=nonce, as_of_ms=as_of_ms)

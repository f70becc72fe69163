"""Restoring in its columns: the line, what is awaited, and which agents are held."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import (
    AgentsHeld,
    AgentVouched,
    LineBegun,
    PointHeard,
    StoreRestored,
    StoreResumed,
)
from ztpm_idp.store import schema as t
from ztpm_idp.store.revocations import batches

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.events import RestoringEvent
    from ztpm_idp.store.counters import Counting
    from ztpm_idp.store.revocations import Revocations


class Restoring:
    """Access of one transaction to what a restore waits for."""

    def __init__(self, connection: AsyncConnection, counting: Counting, revocations: Revocations) -> None:
        self._connection = connection
        self._counting = counting
        self._revocations = revocations

    async def lacks(self, digests: Iterable[str]) -> set[str]:
        """Those of these ledger entries, by hash, that this ledger does not hold."""
        wanted, found = sorted(set(digests)), set[str]()
        for batch in batches(wanted):
            query = sa.select(t.ledger.c.hash).where(t.ledger.c.hash.in_(batch))
            found.update((await self._connection.execute(query)).scalars())
        return set(wanted) - found

    async def write(self, event: RestoringEvent) -> None:
        """The event is in its columns."""
        match event:
            case StoreRestored(line=line):
                await self._revocations.begin(line)
                await self._connection.execute(sa.update(t.peps).values(heard=False))
                await self._counting.change(restoring=True)
            case LineBegun(line=line):
                await self._revocations.begin(line)
            case PointHeard(pep=pep):
                await self._connection.execute(sa.update(t.peps).where(t.peps.c.id == pep).values(heard=True))
            case AgentsHeld(agents=agents):
                for batch in batches(list(agents)):
                    await self._connection.execute(
                        sa.update(t.agents).where(t.agents.c.id.in_(batch)).values(held=True)
                    )
            case StoreResumed(unheard=unheard):
                await self._counting.change(restoring=False)
                if unheard:
                    await self._connection.execute(sa.update(t.agents).values(held=True))
            case AgentVouched(agent=agent):
                await self._connection.execute(sa.update(t.agents).where(t.agents.c.id == agent).values(held=False))
            case _:
                assert_never(event)

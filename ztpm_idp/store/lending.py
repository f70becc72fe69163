"""Hops in their table: who lent authority to whom, and in which tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import RevocationKind, TokenDelegated, TokenIssued
from ztpm_idp.domain.state import HopRecord
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.state import Wanted

Lent = Literal[RevocationKind.TOKEN, RevocationKind.HOP, RevocationKind.MANDATE]
"""Kinds of what is lent."""


@dataclass(frozen=True, slots=True)
class _Place:
    """Place of a new hop."""

    token_id: str
    sponsor: str
    parent: str | None
    position: int


class Lending:
    """Access of one transaction to what was lent."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def hops(self, wanted: Wanted) -> dict[str, HopRecord]:
        """The wanted hop and those above it, or the first hop of the wanted token, by id."""
        c, found = t.hops.c, dict[str, HopRecord]()
        query = sa.select(c.hop_id, c.token_id, c.parent, c.agent, c.sponsor)
        if wanted.token is not None:
            for row in await self._connection.execute(query.where(c.token_id == wanted.token, c.parent.is_(None))):
                found[row.hop_id] = HopRecord(*row)
        following = wanted.hop
        while following is not None and following not in found:
            above = (await self._connection.execute(query.where(c.hop_id == following))).one_or_none()
            if above is None:
                break
            found[above.hop_id] = HopRecord(*above)
            following = above.parent
        return found

    async def knows(self, kind: Lent, id_: str) -> bool:
        """True where such a thing was ever made here."""
        if kind is RevocationKind.MANDATE:
            return False
        found = t.hops.c.token_id if kind is RevocationKind.TOKEN else t.hops.c.hop_id
        query = sa.select(found).where(found == id_).limit(1)
        return (await self._connection.execute(query)).scalar_one_or_none() is not None

    async def write(self, event: TokenIssued | TokenDelegated, *, at_ms: int) -> None:
        """Writes the hop that was made."""
        match event:
            case TokenIssued():
                place = _Place(event.token_id, event.sponsor.subject, None, 0)
            case TokenDelegated(chain=chain):
                place = _Place(chain.token_id, chain.sponsor.subject, chain.leaf.hop_id, len(chain.hops))
            case _:
                assert_never(event)
        hop = event.hop
        await self._connection.execute(
            sa.insert(t.hops).values(
                hop_id=hop.hop_id,
                token_id=place.token_id,
                parent=place.parent,
                position=place.position,
                agent=hop.agent,
                sponsor=place.sponsor,
                made_ms=at_ms,
                not_after=event.scope.not_after,
            )
        )

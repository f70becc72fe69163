"""Authority that was lent, in its tables: hops, each in its tree, and mandates with the tokens drawn from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import MandateSigned, RevocationKind, TokenDelegated, TokenIssued
from ztpm_idp.domain.state import Drawn, HopRecord, MandateRecord
from ztpm_idp.store import prepared
from ztpm_idp.store import schema as t
from ztpm_idp.store.database import postgres, postgres_trips
from ztpm_idp.store.errors import OnceOnlyError
from ztpm_idp.store.revocations import batches

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.events import NonceConsumed
    from ztpm_idp.domain.state import Wanted

CREDENTIAL_GRACE_MS: Final = 3_600_000
"""Milliseconds for which a spent token is remembered after its end: a clock that jumps back an hour revives none."""
SHOWN: Final = 256
"""Most mandates, or tokens of one, in one list."""
Lent = Literal[RevocationKind.TOKEN, RevocationKind.HOP, RevocationKind.MANDATE]
"""Kinds of what is lent."""
_IDS: Final = {
    RevocationKind.TOKEN: t.hops.c.token_id,
    RevocationKind.HOP: t.hops.c.hop_id,
    RevocationKind.MANDATE: t.mandates.c.mandate_id,
}


_NEW_HOPS: Final = postgres_trips.Inserting(t.hops)


@dataclass(frozen=True, slots=True)
class LentHop:
    """Hop as people are shown it.

    Attributes:
        hop_id, token_id: of the hop and its token.
        parent: hop from which it was lent on; None of a first one.
        agent, sponsor: who holds it, and at whom its chain starts.
        made_ms: wall clock.
        not_after: its end, seconds since the epoch.
        mandate: id of that from which its token was drawn, of a first one; else None.
    """

    hop_id: str
    token_id: str
    parent: str | None
    agent: str
    sponsor: str
    made_ms: int
    not_after: int
    mandate: str | None


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
        found = dict[str, HopRecord]()
        if wanted.token is not None:
            found |= (await self.first_hops([wanted.token]))[wanted.token]
        following = wanted.hop
        while following is not None and following not in found:
            query = prepared.HOPS.where(t.hops.c.hop_id == following)
            above = (await self._connection.execute(query)).one_or_none()
            if above is None:
                break
            found[above.hop_id] = HopRecord(*above)
            following = above.parent
        return found

    async def first_hops(self, tokens: Collection[str]) -> dict[str, dict[str, HopRecord]]:
        """The first hop of each of these tokens by its id, by token; nothing of one that was never made."""
        found: dict[str, dict[str, HopRecord]] = {token: {} for token in tokens}
        if not tokens:
            return found
        return found | hops_by_token(await self._connection.execute(prepared.FIRST_HOPS, {"tokens": sorted(tokens)}))

    async def knows(self, kind: Lent, id_: str) -> bool:
        """True where such a thing was ever made here."""
        found = _IDS[kind]
        query = sa.select(found).where(found == id_).limit(1)
        return (await self._connection.execute(query)).scalar_one_or_none() is not None

    async def refusals(self, agents: Collection[str]) -> dict[str, tuple[int, int]]:
        """Since when, wall clock in milliseconds, and how many refusals of these agents were counted, if any."""
        if not agents:
            return {}
        return refusals_by_agent(await self._connection.execute(prepared.REFUSALS, {"refusals_of": sorted(agents)}))

    async def mandate(self, mandate_id: str | None) -> MandateRecord | None:
        """The mandate, when there is one."""
        if mandate_id is None:
            return None
        found = await self._mandates(t.mandates.c.mandate_id == mandate_id)
        return found[0] if found else None

    async def mandates(
        self, *, since_s: int, agents: Collection[str], key: str | None, sponsor: str | None
    ) -> tuple[MandateRecord, ...]:
        """Mandates of these agents, or by this key or sponsor, that end at `since_s` or later and are not revoked."""
        if not agents and key is None and sponsor is None:
            return ()
        if key is None and sponsor is None:
            mine_alone = await self._connection.execute(
                prepared.MANDATES_OF, {"conduct_of": sorted(agents), "since_s": since_s}
            )  # fmt: skip
            return tuple(MandateRecord(*row) for row in mine_alone)
        c = t.mandates.c
        mine = sa.or_(c.agent.in_(sorted(agents)), c.key == key, c.sponsor == sponsor)
        return tuple(found for found in await self._mandates(mine, c.not_after >= since_s) if not found.revoked)

    async def tokens_from(self, sponsor: str | None, *, since_s: int) -> tuple[str, ...]:
        """Ids of this sponsor's tokens that end at `since_s` or later and are not revoked, in order."""
        if sponsor is None:
            return ()
        c = t.hops.c
        found = await self._connection.execute(
            sa.select(c.token_id)
            .where(c.sponsor == sponsor, c.parent.is_(None), c.not_after >= since_s, ~_revoked("token", c.token_id))
            .order_by(c.token_id)
        )
        return tuple(found.scalars())

    async def living_hops(self, sponsors: Collection[str], *, at_s: int, most: int) -> list[LentHop]:
        """Hops of these sponsors that are not over, each after the one above it, revoked or not.

        At most so many, of the newest tokens.
        """
        c, first, found = t.hops.c, list[tuple[int, str]](), list[LentHop]()
        for some in batches(sorted(sponsors)):
            lent = sa.select(c.made_ms, c.token_id).where(c.sponsor.in_(some), c.parent.is_(None), c.not_after > at_s)
            newest = lent.order_by(c.made_ms.desc(), c.token_id).limit(most)
            first += [(made_ms, token) for made_ms, token in await self._connection.execute(newest)]
        tokens = [token for _, token in sorted(first, reverse=True)[:most]]
        shown = sa.select(c.hop_id, c.token_id, c.parent, c.agent, c.sponsor, c.made_ms, c.not_after, c.mandate)
        for some in batches(tokens):
            query = shown.where(c.token_id.in_(some), c.not_after > at_s).order_by(c.position, c.made_ms, c.hop_id)
            found += [LentHop(*row) for row in await self._connection.execute(query.limit(most - len(found)))]
            if len(found) >= most:
                break
        return found

    async def mandates_of(self, party: str | None) -> list[MandateRecord]:
        """Mandates that this party signed or received, or of all parties: the newest `SHOWN`, the newest first."""
        c = t.mandates.c
        found = await self._mandates(sa.true() if party is None else sa.or_(c.sponsor == party, c.agent == party))
        return found[:SHOWN]

    async def drawn(self, mandate_id: str | None, *, since_s: int = 0) -> tuple[Drawn, ...]:
        """Tokens that were drawn from a mandate and end at `since_s` or later, the newest first."""
        if mandate_id is None:
            return ()
        c = t.hops.c
        over = sa.or_(_revoked("token", c.token_id), _revoked("hop", c.hop_id))
        found = await self._connection.execute(
            sa.select(c.token_id, c.hop_id, c.made_ms, c.not_after, over)
            .where(c.mandate == mandate_id, c.not_after >= since_s)
            .order_by(c.made_ms.desc(), c.hop_id)
        )
        return tuple(Drawn(token, hop, made, end, bool(dead)) for token, hop, made, end, dead in found)

    async def _mandates(self, *conditions: sa.ColumnElement[bool]) -> list[MandateRecord]:
        found = await self._connection.execute(prepared.MANDATES.where(*conditions))
        return [MandateRecord(*row) for row in found]

    async def sign(self, event: MandateSigned) -> None:
        """Writes the mandate that was signed."""
        made = event.mandate
        await self._connection.execute(
            sa.insert(t.mandates).values(
                mandate_id=made.mandate_id,
                digest=made.digest,
                sponsor=made.sponsor,
                agent=made.agent,
                key=made.key,
                signed_at=made.signed_at,
                not_after=made.not_after,
                text=made.text,
            )
        )

    async def write(self, made: Iterable[TokenIssued | TokenDelegated], *, at_ms: int) -> None:
        """Writes the hops that were made."""
        hops = [_row(event, at_ms) for event in made]
        if hops and self._connection.dialect.name == postgres.DIALECT:
            await _NEW_HOPS.write(self._connection, hops)
        elif hops:
            await self._connection.execute(prepared.NEW_HOP, hops)


def hops_by_token(rows: Iterable[Any]) -> dict[str, dict[str, HopRecord]]:
    """Hops of rows of `prepared.HOPS` by their ids, by token."""
    found = dict[str, dict[str, HopRecord]]()
    for row in rows:
        found.setdefault(row.token_id, {})[row.hop_id] = HopRecord(*row)
    return found


def refusals_by_agent(rows: Iterable[Any]) -> dict[str, tuple[int, int]]:
    """Since when, and how many, of rows of `prepared.REFUSALS`, by agent."""
    return {agent: (since_ms, number) for agent, since_ms, number in rows}


def _row(event: TokenIssued | TokenDelegated, at_ms: int) -> dict[str, object]:
    """Row of a hop."""
    match event:
        case TokenIssued():
            place, mandate_id = _Place(event.token_id, event.sponsor.subject, None, 0), event.mandate_id
        case TokenDelegated(chain=chain):
            place, mandate_id = _Place(chain.token_id, chain.sponsor.subject, chain.leaf.hop_id, len(chain.hops)), None
        case _:
            assert_never(event)
    return {
        "hop_id": event.hop.hop_id,
        "token_id": place.token_id,
        "parent": place.parent,
        "position": place.position,
        "agent": event.hop.agent,
        "sponsor": place.sponsor,
        "made_ms": at_ms,
        "not_after": event.scope.not_after,
        "mandate": mandate_id,
    }


def _revoked(kind: str, column: sa.Column[str]) -> sa.ColumnElement[bool]:
    """Condition that the id in this column is in the index of revocations."""
    r = t.revocations.c
    return sa.select(r.id).where(r.kind == kind, r.id == column).exists()


async def spend(connection: AsyncConnection, events: Sequence[NonceConsumed], *, at_ms: int) -> None:
    """Spends nonces, and with each the platform's token that was shown with it: all of them count once.

    A spent token is remembered for as long as it could be shown, and a clock's jump more.

    Raises:
        OnceOnlyError: one of them was spent before.
    """
    if not events:
        return
    purposes = {event.nonce: event.purpose for event in events}
    if connection.dialect.name == postgres.DIALECT:
        spent = await postgres_trips.spend(connection, purposes)
    else:
        spent = list(await connection.scalars(prepared.UNSPENT, {"ids": sorted(purposes)}))
        await connection.execute(prepared.SPEND, [{"nonce_": one, "purpose": on} for one, on in purposes.items()])
    if len(purposes) < len(events) or len(spent) < len(purposes):
        raise OnceOnlyError
    for event in events:
        if event.credential:
            await _spend_credential(connection, event, at_ms=at_ms)


async def _spend_credential(connection: AsyncConnection, event: NonceConsumed, *, at_ms: int) -> None:
    credentials = t.spent_credentials.c
    over = credentials.until_ms < at_ms - CREDENTIAL_GRACE_MS
    await connection.execute(sa.delete(t.spent_credentials).where(over))
    known = await connection.execute(sa.select(credentials.digest).where(credentials.digest == event.credential))
    if known.first() is not None:
        raise OnceOnlyError
    row = {"digest": event.credential, "until_ms": event.credential_until_ms}
    await connection.execute(sa.insert(t.spent_credentials).values(row))

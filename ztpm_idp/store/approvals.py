"""Asks, votes and openings in their tables: reads for commands and readers, writes of their events."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final, assert_never

import sqlalchemy as sa

from capabilities.statements.people.picture import digest_of
from ztpm_idp.domain.asking.asks import Answer, Asked, AskRecord, OpeningRecord, VoteRecord
from ztpm_idp.domain.events import AskTaken, OpeningClosed, OpeningMade, VoteCast
from ztpm_idp.domain.parties import PersonRole, Standing
from ztpm_idp.store import schema as t
from ztpm_idp.store.pictures.pictures import Pictures

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

HOUR_S: Final = 3_600
ApprovalEvent = AskTaken | VoteCast | OpeningMade | OpeningClosed

_ASK = (
    t.asks.c.ask_id,
    t.asks.c.nonce,
    t.asks.c.digest,
    t.asks.c.pep,
    t.asks.c.audience,
    t.asks.c.agent,
    t.asks.c.sponsor,
    t.asks.c.approvers,
    t.asks.c.fresh,
    t.asks.c.asked_at,
    t.asks.c.expires_at,
    t.asks.c.trace_id,
)
"""The columns of an `AskRecord`, in its order."""


class Approvals:
    """Access of one transaction to asks, votes and openings."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection
        self._pictures = Pictures(connection)

    async def asked(self, ask_id: str | None) -> Asked | None:
        """The ask with its votes, when there is one."""
        found = await self._with_votes(t.asks.c.ask_id == ask_id)
        return found[0] if found else None

    async def signed(self, ask_ids: frozenset[str]) -> dict[str, tuple[str, bytes]]:
        """The texts of these asks as they were signed, each with the key of the enforcement point that signed it."""
        found = await self._connection.execute(
            sa.select(t.asks.c.ask_id, t.asks.c.text, t.parties.c.key)
            .join_from(t.asks, t.parties, t.parties.c.id == t.asks.c.pep)
            .where(t.asks.c.ask_id.in_(sorted(ask_ids)))
        )
        return {ask_id: (text, bytes(key)) for ask_id, text, key in found}

    async def picture(self, ask_id: str) -> str:
        """The text of the picture that the ask names; "" where it names none, or none is kept any more."""
        found = await self._connection.execute(sa.select(t.asks.c.picture_digest).where(t.asks.c.ask_id == ask_id))
        return await self._pictures.text(found.scalar_one_or_none()) or ""

    async def not_long_over(self, *, since_s: int, audience: str | None = None) -> list[Asked]:
        """Asks that end, or have a vote that ends, at `since_s` or later, oldest first.

        Args:
            since_s: seconds since the epoch.
            audience: only of this one, unless None.
        """
        lasting = sa.select(t.votes.c.ask_id).where(t.votes.c.not_after >= since_s)
        condition = sa.or_(t.asks.c.expires_at >= since_s, t.asks.c.ask_id.in_(lasting))
        if audience is not None:
            condition = sa.and_(condition, t.asks.c.audience == audience)
        return await self._with_votes(condition)

    async def standing(self, audience: str, *, since_s: int) -> tuple[Asked, ...]:
        """Every ask that may be open at `since_s` or later, and those of this audience that may be granted then."""
        open_ = await self._with_votes(t.asks.c.expires_at >= since_s)
        known = {asked.ask.ask_id for asked in open_}
        more = await self.not_long_over(since_s=since_s, audience=audience)
        return (*open_, *(asked for asked in more if asked.ask.ask_id not in known))

    async def taken(self, *, since_s: int) -> tuple[int, ...]:
        """Wall clock, in ms, of the taking of each ask since an hour before `since_s`, and of some older ones."""
        c = t.asks.c
        # An ask ends after it was taken, and its end has an index.
        found = await self._connection.execute(sa.select(c.taken_ms).where(c.expires_at >= since_s - HOUR_S))
        return tuple(found.scalars())

    async def opening(self, opening_id: str | None) -> OpeningRecord | None:
        """The opening, when there is one."""
        found = (
            await self._connection.execute(sa.select(t.openings).where(t.openings.c.opening_id == opening_id))
        ).one_or_none()
        return None if found is None else _opening(found)

    async def openings(self, *, since_s: int, audience: str | None = None) -> tuple[OpeningRecord, ...]:
        """Openings that nobody took back and that end at `since_s` or later, in the order in which they were made."""
        c = t.openings.c
        query = sa.select(t.openings).where(c.closed_ms.is_(None), c.not_after >= since_s).order_by(c.made_ms)
        if audience is not None:
            query = query.where(c.audience == audience)
        return tuple(_opening(row) for row in await self._connection.execute(query))

    async def served(self, audience: str) -> frozenset[str]:
        """The audience, when an active enforcement point serves it; else nothing."""
        p = t.parties.c
        found = await self._connection.execute(
            sa.select(t.peps.c.audiences)
            .join_from(t.peps, t.parties, p.id == t.peps.c.id)
            .where(p.standing == Standing.ACTIVE.value)
        )
        return frozenset({audience}) & {name for (audiences,) in found for name in audiences}

    async def write(self, event: ApprovalEvent, *, actor: str, at_ms: int) -> None:
        """The event is in its table."""
        match event:
            case AskTaken(ask=ask, text=text, picture=picture):
                values = {column.name: getattr(ask, column.name) for column in _ASK}
                digest = digest_of(picture) if picture else ""
                if digest:
                    await self._pictures.keep(digest, picture, at_ms=at_ms)
                statement: Any = sa.insert(t.asks).values(**values, text=text, taken_ms=at_ms, picture_digest=digest)
            case VoteCast(ask_id=ask_id, place=place, vote=vote):
                statement = sa.insert(t.votes).values(
                    ask_id=ask_id,
                    place=place,
                    approver=vote.approver,
                    answer=vote.answer.value,
                    withdraws=vote.answer is Answer.WITHDRAW,
                    not_after=vote.not_after,
                    text=vote.text,
                    cast_ms=at_ms,
                )
            case OpeningMade(opening=opening):
                statement = sa.insert(t.openings).values(
                    opening_id=opening.opening_id,
                    digest=opening.digest,
                    opener=opening.opener,
                    audience=opening.audience,
                    agent=opening.agent,
                    object=opening.object,
                    operation=opening.operation,
                    not_before=opening.not_before,
                    not_after=opening.not_after,
                    text=opening.text,
                    made_ms=at_ms,
                )
            case OpeningClosed(opening_id=opening_id, reason=reason):
                statement = (
                    sa.update(t.openings)
                    .where(t.openings.c.opening_id == opening_id, t.openings.c.closed_ms.is_(None))
                    .values(closed_ms=at_ms, closed_by=actor, closed_reason=reason)
                )
            case _:
                assert_never(event)
        await self._connection.execute(statement)

    async def _with_votes(self, condition: sa.ColumnElement[bool]) -> list[Asked]:
        v, p = t.votes.c, t.parties.c
        votes: dict[str, list[VoteRecord]] = defaultdict(list)
        found = await self._connection.execute(
            sa.select(v.ask_id, v.approver, v.answer, v.not_after, p.standing, t.people.c.roles, v.text)
            .join_from(t.votes, t.parties, p.id == v.approver)
            .join(t.people, t.people.c.id == p.id)
            .where(v.ask_id.in_(sa.select(t.asks.c.ask_id).where(condition)))
            .order_by(v.ask_id, v.place)
        )
        for ask_id, approver, answer, not_after, standing, roles, text in found:
            active = standing == Standing.ACTIVE.value and PersonRole.APPROVER.value in roles
            votes[ask_id].append(VoteRecord(approver, Answer(answer), not_after, active, text))
        over = sa.select(p.id).where(p.id.in_((t.asks.c.agent, t.asks.c.sponsor)), p.standing == Standing.REVOKED.value)
        asks = await self._connection.execute(
            sa.select(*_ASK, over.exists()).where(condition).order_by(t.asks.c.taken_ms, t.asks.c.ask_id)
        )
        return [Asked(AskRecord(*row), tuple(votes[row[0]]), bool(ended)) for *row, ended in asks]


def _opening(row: sa.Row[Any]) -> OpeningRecord:
    return OpeningRecord(
        opening_id=row.opening_id,
        digest=row.digest,
        opener=row.opener,
        audience=row.audience,
        agent=row.agent,
        object=row.object,
        operation=row.operation,
        not_before=row.not_before,
        not_after=row.not_after,
        closed=row.closed_ms is not None,
        text=row.text,
    )

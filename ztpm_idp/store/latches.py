"""Latches and their clearings in their tables: reads for commands and readers, writes of their events."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.asking.latch_acts import ClearingRecord, ClearingSigned, LatchRecord, LatchTaken
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.asking.latch_acts import LatchEvent


class Latches:
    """Access of one transaction to latches."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def one(self, latch_id: str | None) -> LatchRecord | None:
        """The latch, when there is one."""
        if latch_id is None:
            return None
        found = await self._found(t.latches.c.latch_id == latch_id)
        return found[0] if found else None

    async def newest(self, most: int) -> list[LatchRecord]:
        """The newest latches, the last told first."""
        return await self._found(most=most)

    async def not_long_over(self, *, since_ms: int, most: int) -> list[LatchRecord]:
        """Latches that wait, or were cleared since then: the newest of them, the oldest first."""
        c = t.latches.c
        found = await self._found(c.released_ms.is_(None) | (c.released_ms >= since_ms), most=most)
        return found[::-1]

    async def signed(self, latch_ids: frozenset[str]) -> dict[str, tuple[str, bytes]]:
        """Text of each of these latches, and the key of the enforcement point that told of it."""
        found = await self._connection.execute(
            sa.select(t.latches.c.latch_id, t.latches.c.text, t.parties.c.key)
            .join_from(t.latches, t.parties, t.parties.c.id == t.latches.c.pep)
            .where(t.latches.c.latch_id.in_(sorted(latch_ids)))
        )
        return {row.latch_id: (row.text, bytes(row.key)) for row in found}

    async def signer(self, latch_id: str) -> bytes:
        """The key of the enforcement point that told of that latch, which there is."""
        found = await self._connection.execute(
            sa.select(t.parties.c.key)
            .join_from(t.latches, t.parties, t.parties.c.id == t.latches.c.pep)
            .where(t.latches.c.latch_id == latch_id)
        )
        return bytes(found.scalar_one())

    async def clearings(self, latch_id: str | None) -> tuple[ClearingRecord, ...]:
        """Clearings of that latch, in the order in which they came."""
        if latch_id is None:
            return ()
        c = t.latch_clearings.c
        return await self._clearings(sa.select(t.latch_clearings).where(c.latch_id == latch_id).order_by(c.number))

    async def counting(self, audience: str, *, at_s: int, most: int) -> tuple[str, ...]:
        """Texts of the clearings for an audience that are not over, the newest."""
        c = t.latch_clearings.c
        asked = (
            sa.select(t.latch_clearings)
            .join_from(t.latch_clearings, t.latches, t.latches.c.latch_id == c.latch_id)
            .where(t.latches.c.audience == audience, c.not_after >= at_s)
            .order_by(c.signed_ms.desc(), c.number.desc())
            .limit(most)
        )
        return tuple(each.text for each in await self._clearings(asked))

    async def write(self, event: LatchEvent, *, at_ms: int) -> None:
        """The event is in its table."""
        c = t.latches.c
        match event:
            case LatchTaken(latch=latch):
                stated = {"digest": latch.digest, "text": latch.text, "told_ms": at_ms, "released_ms": None}
                again = await self._connection.execute(
                    sa.update(t.latches).where(c.latch_id == latch.latch_id).values(**stated)
                )
                if again.rowcount:
                    return
                await self._connection.execute(
                    sa.insert(t.latches).values(
                        latch_id=latch.latch_id,
                        pep=latch.pep,
                        audience=latch.audience,
                        robot=latch.robot,
                        cause=latch.cause,
                        approvers=latch.approvers,
                        at=latch.at,
                        **stated,
                    )
                )
            case ClearingSigned(latch_id=latch_id, number=number, clearing=made, released=released):
                await self._connection.execute(
                    sa.insert(t.latch_clearings).values(
                        latch_id=latch_id,
                        number=number,
                        approver=made.approver,
                        not_after=made.not_after,
                        latch_digest=made.latch_digest,
                        signed_ms=at_ms,
                        text=made.text,
                    )
                )
                if released:
                    await self._connection.execute(
                        sa.update(t.latches).where(c.latch_id == latch_id).values(released_ms=at_ms)
                    )
            case _:
                assert_never(event)

    async def _found(self, *conditions: sa.ColumnElement[bool], most: int | None = None) -> list[LatchRecord]:
        c = t.latches.c
        asked = sa.select(t.latches).where(*conditions).order_by(c.told_ms.desc(), c.latch_id).limit(most)
        rows = await self._connection.execute(asked)
        return [
            LatchRecord(
                latch_id=row.latch_id,
                digest=row.digest,
                pep=row.pep,
                audience=row.audience,
                robot=row.robot,
                cause=row.cause,
                approvers=row.approvers,
                at=row.at,
                text=row.text,
                released=row.released_ms is not None,
            )
            for row in rows
        ]

    async def _clearings(self, asked: sa.Select[tuple[object, ...]]) -> tuple[ClearingRecord, ...]:
        rows = await self._connection.execute(asked)
        return tuple(ClearingRecord(row.approver, row.not_after, row.latch_digest, row.text) for row in rows)

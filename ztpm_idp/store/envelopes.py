"""Envelopes in their table: reads for commands and readers, writes of their events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.asking.envelope_acts import EnvelopeRecord, EnvelopeRevoked, EnvelopeSigned
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.asking.envelope_acts import EnvelopeEvent


class Envelopes:
    """Access of one transaction to envelopes."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def one(self, envelope_id: str | None) -> EnvelopeRecord | None:
        """The envelope, when there is one."""
        if envelope_id is None:
            return None
        found = await self._found(t.envelopes.c.envelope_id == envelope_id)
        return found[0] if found else None

    async def lasting(self, *, since_s: int, audience: str | None = None) -> tuple[EnvelopeRecord, ...]:
        """Envelopes that nobody revoked and that end at `since_s` or later, in the order in which they were signed."""
        c = t.envelopes.c
        conditions = (c.revoked_ms.is_(None), c.not_after >= since_s)
        return tuple(await self._found(*conditions, *(() if audience is None else (c.audience == audience,))))

    async def write(self, event: EnvelopeEvent, *, actor: str, at_ms: int) -> None:
        """The event is in its table."""
        match event:
            case EnvelopeSigned(envelope=made):
                statement: Any = sa.insert(t.envelopes).values(
                    envelope_id=made.envelope_id,
                    digest=made.digest,
                    approver=made.approver,
                    audience=made.audience,
                    agent=made.agent,
                    not_before=made.not_before,
                    not_after=made.not_after,
                    text=made.text,
                    signed_ms=at_ms,
                )
            case EnvelopeRevoked(envelope_id=envelope_id, reason=reason):
                statement = (
                    sa.update(t.envelopes)
                    .where(t.envelopes.c.envelope_id == envelope_id, t.envelopes.c.revoked_ms.is_(None))
                    .values(revoked_ms=at_ms, revoked_by=actor, revoked_reason=reason)
                )
            case _:
                assert_never(event)
        await self._connection.execute(statement)

    async def _found(self, *conditions: sa.ColumnElement[bool]) -> list[EnvelopeRecord]:
        c = t.envelopes.c
        rows = await self._connection.execute(sa.select(t.envelopes).where(*conditions).order_by(c.signed_ms))
        return [
            EnvelopeRecord(
                envelope_id=row.envelope_id,
                digest=row.digest,
                approver=row.approver,
                audience=row.audience,
                agent=row.agent,
                not_before=row.not_before,
                not_after=row.not_after,
                revoked=row.revoked_ms is not None,
                text=row.text,
            )
            for row in rows
        ]

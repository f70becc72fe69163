"""Enrolments in their table: passkeys that people are making, each for minutes and once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import sqlalchemy as sa

from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection


@dataclass(frozen=True, slots=True)
class Enrolment:
    """A passkey that a person is making.

    Attributes:
        enrolment_id: 32 hex digits; who knows them may make the credential.
        person: who began it, and alone may propose its outcome.
        expires_ms: wall clock.
        credential, key: of the credential that a browser has made, else None.
    """

    enrolment_id: str
    person: str
    expires_ms: int
    credential: str | None
    key: bytes | None


class Enrolments:
    """Access of one transaction to enrolments."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def begin(self, enrolment: Enrolment, *, at_ms: int, most: int) -> bool:
        """True where the enrolment is begun: its person has fewer than `most` that are not over at `at_ms`."""
        c = t.enrolments.c
        await self._connection.execute(sa.delete(t.enrolments).where(c.expires_ms <= at_ms))
        mine = sa.select(sa.func.count()).select_from(t.enrolments).where(c.person == enrolment.person)
        if not int((await self._connection.execute(mine)).scalar_one()) < most:
            return False
        await self._connection.execute(
            sa.insert(t.enrolments).values(
                enrolment_id=enrolment.enrolment_id, person=enrolment.person, expires_ms=enrolment.expires_ms
            )
        )
        return True

    async def found(self, enrolment_id: str, *, at_ms: int) -> Enrolment | None:
        """The enrolment, when there is one that is not over at `at_ms`."""
        c = t.enrolments.c
        row = (
            await self._connection.execute(
                sa.select(t.enrolments).where(c.enrolment_id == enrolment_id, c.expires_ms > at_ms)
            )
        ).one_or_none()
        if row is None:
            return None
        key = None if row.key is None else bytes(row.key)
        return Enrolment(row.enrolment_id, row.person, row.expires_ms, row.credential, key)

    async def made(self, enrolment_id: str, *, credential: str, key: bytes) -> bool:
        """True where the credential is kept: exactly one of each enrolment."""
        c = t.enrolments.c
        kept = await self._connection.execute(
            sa.update(t.enrolments)
            .where(c.enrolment_id == enrolment_id, c.credential.is_(None))
            .values(credential=credential, key=key)
        )
        return bool(kept.rowcount == 1)

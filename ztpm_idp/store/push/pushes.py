"""Pushes of questions and latches in their table, written beside the state: nothing is decided on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import sqlalchemy as sa

from ztpm_idp.domain.asking.pushes import Matter, Occasion, Push, PushCode, PushEvent
from ztpm_idp.store.database import postgres
from ztpm_idp.store.push import push_schema as t
from ztpm_idp.store.schema import latches

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.asking.pushes import Key

MEMORY_MS: Final = 86_400_000
"""Ours: milliseconds after which the row of a push is forgotten; its question was over long before."""


class Pushes:
    """Access of one transaction to pushes."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def turn(self) -> None:
        """No other worker plans until this transaction ends; SQLite has one writer anyway."""
        if self._connection.dialect.name == postgres.DIALECT:
            await postgres.wait_for_turn(self._connection, postgres.PUSH_LOCK)

    async def of(self, subjects: Iterable[Occasion]) -> dict[Key, Push]:
        """The pushes of these asks and latches."""
        c, wanted = t.pushes.c, sorted(subjects)
        if not wanted:
            return {}
        # Ids are random: one that is an ask's is no latch's, but for what somebody makes so.
        found = await self._connection.execute(
            sa.select(t.pushes).where(c.subject_id.in_(sorted({each.id for each in wanted})))
        )
        rows = (
            Push(
                Occasion(Matter(row.matter), row.subject_id), row.webhook, PushEvent(row.event), row.tries,
                row.begun_ms, row.due_ms, PushCode(row.code) if row.code else None, row.done,
            )
            for row in found
        )  # fmt: skip
        return {push.key: push for push in rows if push.subject in wanted}

    async def keep(self, pushes: Iterable[Push], *, known: Mapping[Key, Push]) -> None:
        """The pushes are in the table.

        Args:
            pushes: as they are now.
            known: those that have a row.
        """
        for push in pushes:
            if push.key in known:
                await self.change(push)
            else:
                await self._connection.execute(sa.insert(t.pushes).values(**_values(push)))

    async def change(self, push: Push) -> None:
        """A push that has a row is as it is now."""
        c = t.pushes.c
        where = (*_of(push.subject), c.webhook == push.webhook, c.event == push.event.value)
        await self._connection.execute(sa.update(t.pushes).where(*where).values(**_values(push)))

    async def forget(self, *, at_ms: int) -> None:
        """Pushes of what was over long ago have no row any more.

        Those of a latch have one until it was cleared long ago: it is told of once, however long it waits, and of its
        end.
        """
        c, since_ms = t.pushes.c, at_ms - MEMORY_MS
        lasts = sa.exists().where(
            c.matter == Matter.LATCH.value,
            latches.c.latch_id == c.subject_id,
            sa.or_(latches.c.released_ms.is_(None), latches.c.released_ms >= since_ms),
        )
        await self._connection.execute(sa.delete(t.pushes).where(c.due_ms < since_ms, ~lasts))

    async def begin_again(self, latch_id: str) -> None:
        """A latch that people had cleared, and that waits once more, is told of once more."""
        cleared = sa.exists().where(latches.c.latch_id == latch_id, latches.c.released_ms.is_not(None))
        await self._connection.execute(sa.delete(t.pushes).where(*_of(Occasion(Matter.LATCH, latch_id)), cleared))


def _of(subject: Occasion) -> tuple[sa.ColumnElement[bool], ...]:
    return t.pushes.c.matter == subject.matter.value, t.pushes.c.subject_id == subject.id


def _values(push: Push) -> dict[str, object]:
    return {
        "matter": push.subject.matter.value,
        "subject_id": push.subject.id,
        "webhook": push.webhook,
        "event": push.event.value,
        "tries": push.tries,
        "begun_ms": push.begun_ms,
        "due_ms": push.due_ms,
        "code": "" if push.code is None else push.code.value,
        "done": push.done,
    }

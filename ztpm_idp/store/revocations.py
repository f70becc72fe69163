"""Revocations in their table: one index, ordered by epoch, and the chain over it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import sqlalchemy as sa

from capabilities.statements.revocation import ended_after_s, first_head, next_head
from ztpm_idp.domain.events import RevocationKind, Revoked
from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import prepared
from ztpm_idp.store import schema as t
from ztpm_idp.store.joined import BATCH

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

    from capabilities.values.caps import Caps
    from ztpm_idp.store.counters import Counting

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class MadeRevocation:
    """Revocation as it stands in the index.

    Attributes:
        epoch: its own.
        kind, id: of what is revoked.
        by: who did it.
        reason: as it was given.
        at_ms: wall clock.
    """

    epoch: int
    kind: str
    id: str
    by: str
    reason: str
    at_ms: int


class Revocations:
    """Access of one transaction to the index of revocations."""

    def __init__(self, connection: AsyncConnection, counting: Counting) -> None:
        self._connection = connection
        self._counting = counting

    async def at(self, epoch: int) -> MadeRevocation | None:
        """The revocation of this epoch."""
        c = t.revocations.c
        query = sa.select(c.epoch, c.kind, c.id, c.by, c.reason, c.at_ms).where(c.epoch == epoch)
        row = (await self._connection.execute(query)).one_or_none()
        return None if row is None else MadeRevocation(*row)

    async def since(self, since: int, most: int) -> list[tuple[int, str, str]]:
        """(epoch, kind, id) of revocations with a higher epoch, in order, at most `most`."""
        c = t.revocations.c
        found = await self._connection.execute(
            sa.select(c.epoch, c.kind, c.id).where(c.epoch > since).order_by(c.epoch).limit(most)
        )  # fmt: skip
        return [(epoch, kind, id_) for epoch, kind, id_ in found]

    async def living(self, since: int, most: int, *, base: int, caps: Caps) -> list[tuple[int, str, str]]:
        """As `since`, but up to epoch `base` without those that had ended when the revocation of `base` was made."""
        c = t.revocations.c
        made_ms = await self._connection.scalar(sa.select(c.at_ms).where(c.epoch == base))
        passing = {kind.value: after_s for kind in RevocationKind if (after_s := ended_after_s(kind, caps)) is not None}
        living = [
            sa.and_(c.kind == kind, c.at_ms >= (made_ms or 0) - after_s * 1_000) for kind, after_s in passing.items()
        ]
        kept = sa.or_(c.epoch > base, c.kind.not_in(sorted(passing)), *living)
        found = await self._connection.execute(
            sa.select(c.epoch, c.kind, c.id).where(c.epoch > since, kept).order_by(c.epoch).limit(most)
        )
        return [(epoch, kind, id_) for epoch, kind, id_ in found]

    async def chained(self, head: str, *, after: int, through: int) -> str:
        """Head of the chain at epoch `through`, from that at `after` on."""
        c = t.revocations.c
        query = sa.select(c.epoch, c.kind, c.id).where(c.epoch > after, c.epoch <= through).order_by(c.epoch)
        for epoch, kind, id_ in await self._connection.execute(query):
            head = next_head(head, epoch, kind, id_)
        return head

    async def among(self, names: Iterable[tuple[str, str]]) -> dict[tuple[str, str], int]:
        """Those of these (kind, id) that are revoked, with their epochs."""
        found = dict[tuple[str, str], int]()
        for batch in batches(sorted(set(names))):
            ids = by_kind(batch)
            found |= epochs(await self._connection.execute(prepared.AMONG, ids))
        return found

    async def every(self) -> frozenset[tuple[str, str]]:
        """Every (kind, id) that is revoked."""
        c = t.revocations.c
        return frozenset((kind, id_) for kind, id_ in await self._connection.execute(sa.select(c.kind, c.id)))

    async def write(self, made: Sequence[tuple[str, Revoked]], at_ms: int) -> None:
        """Writes revocations, each with its actor, to the index in this order; ends the parties that end by them."""
        if not made:
            return
        events = [event for _, event in made]
        # The epochs are taken from the locked row inside this transaction: they become visible in their own order.
        counters = await self._counting.locked()
        before, head = counters.epoch, counters.revocation_head
        for epoch, event in enumerate(events, start=before + 1):
            head = next_head(head, epoch, event.kind.value, event.id)
        await self._counting.change(epoch=before + len(events), revocation_head=head)
        index: list[dict[str, object]] = [
            {"epoch": epoch, "kind": e.kind.value, "id": e.id, "by": by, "reason": e.reason, "at_ms": at_ms}
            for epoch, (by, e) in enumerate(made, start=before + 1)
        ]
        for batch in batches(index):
            await self._connection.execute(prepared.NEW_REVOCATION, batch)
        parties = [event.party for event in events if event.party is not None]
        for ended in batches(parties):
            await self._connection.execute(
                sa.update(t.parties).where(t.parties.c.id.in_(ended)).values(standing=Standing.REVOKED.value)
            )
        if parties or any(event.kind is RevocationKind.KEY for event in events):
            await self._counting.next("registry_version")

    async def begin(self, line: int) -> None:
        """Begins a line with every revocation that there is."""
        c, head = t.revocations.c, first_head(line)
        for epoch, kind, id_ in await self._connection.execute(sa.select(c.epoch, c.kind, c.id).order_by(c.epoch)):
            head = next_head(head, epoch, kind, id_)
        await self._counting.change(revocation_line=line, revocation_head=head)


def by_kind(names: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Ids of these (kind, id) under the name of every kind, as `prepared.AMONG` takes them."""
    ids: dict[str, list[str]] = {kind.value: [] for kind in RevocationKind}
    for kind, id_ in names:
        ids[kind].append(id_)
    return ids


def epochs(rows: Iterable[Any]) -> dict[tuple[str, str], int]:
    """Epoch of each (kind, id) of rows of `prepared.AMONG`."""
    return {(kind, id_): epoch for kind, id_, epoch in rows}


def batches(rows: list[_T]) -> Iterator[list[_T]]:
    """The rows, `BATCH` at a time."""
    return (rows[at : at + BATCH] for at in range(0, len(rows), BATCH))

"""Marks of enforcement points in their table, written beside the state: nothing is decided on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import sqlalchemy as sa

from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import schema as t
from ztpm_idp.store.revocations import batches

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sqlalchemy.ext.asyncio import AsyncConnection


@dataclass(frozen=True, slots=True)
class FollowedPoint:
    """Enforcement point, with the mark of the feed that it confirmed.

    Attributes:
        pep: its id.
        audiences: that it serves.
        line, epoch: of its highest mark; -1 where it never confirmed one.
        confirmed_ms: when that came, milliseconds since the epoch.
        heard_ms: when the point was heard last.
    """

    pep: str
    audiences: tuple[str, ...]
    line: int
    epoch: int
    confirmed_ms: int
    heard_ms: int


class Points:
    """Access of one transaction to the marks of enforcement points."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def owner(self, thumbprint: str) -> tuple[str, bytes] | None:
        """Id and key of the active enforcement point whose key has this thumbprint."""
        c = t.parties.c
        query = sa.select(c.id, c.key).where(
            c.thumbprint == thumbprint, c.kind == "pep", c.standing == Standing.ACTIVE.value
        )
        row = (await self._connection.execute(query)).one_or_none()
        return None if row is None else (row.id, bytes(row.key))

    async def every(self) -> list[FollowedPoint]:
        """Every active enforcement point, by id."""
        f, p = t.feed_points.c, t.peps.c
        query = (
            sa.select(p.id, p.audiences, f.line, f.epoch, f.confirmed_ms, f.heard_ms)
            .join_from(t.peps, t.parties, t.parties.c.id == p.id)
            .outerjoin(t.feed_points, f.pep == p.id)
            .where(t.parties.c.standing == Standing.ACTIVE.value)
            .order_by(p.id)
        )
        return [
            FollowedPoint(row.id, tuple(sorted(row.audiences)), -1, -1, 0, 0)
            if row.line is None
            else FollowedPoint(
                row.id, tuple(sorted(row.audiences)), row.line, row.epoch, row.confirmed_ms, row.heard_ms
            )
            for row in await self._connection.execute(query)
        ]

    async def confirm(self, marks: Mapping[str, tuple[int, int, int]]) -> None:
        """Keeps these marks: (line, epoch, when it came in milliseconds since the epoch), by enforcement point."""
        f, known = t.feed_points.c, dict[str, tuple[int, int, int]]()
        for batch in batches(sorted(marks)):
            query = sa.select(f.pep, f.line, f.epoch, f.confirmed_ms).where(f.pep.in_(batch))
            known |= {row.pep: (row.line, row.epoch, row.confirmed_ms) for row in await self._connection.execute(query)}
        rows = list[dict[str, object]]()
        for pep, (line, epoch, at_ms) in marks.items():
            before = known.get(pep, (-1, -1, 0))
            line, epoch, since_ms = (line, epoch, at_ms) if (line, epoch) > before[:2] else before  # noqa: PLW2901
            rows.append({"pep": pep, "line": line, "epoch": epoch, "confirmed_ms": since_ms, "heard_ms": at_ms})
        fresh = [row for row in rows if row["pep"] not in known]
        later = [{f"b_{name}": value for name, value in row.items()} for row in rows if row["pep"] in known]
        if fresh:
            await self._connection.execute(sa.insert(t.feed_points), fresh)
        if later:
            names = ("line", "epoch", "confirmed_ms", "heard_ms")
            update = sa.update(t.feed_points).where(f.pep == sa.bindparam("b_pep"))
            await self._connection.execute(update.values({name: sa.bindparam(f"b_{name}") for name in names}), later)

"""Tree and index of the ledger in their tables: filled in behind the commands, which know nothing of them.

The ledger's numbers have no gap, so its followers take entries in their order, in transactions of their own. Two
who follow at the same time would write the same rows; the row of `ledger_followed` lets one of them pass.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa

from capabilities.log import merkle
from ztpm_idp.domain.audit import AuditRow, row_of
from ztpm_idp.store import schema as t
from ztpm_idp.store.errors import ConflictError
from ztpm_idp.store.revocations import batches

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sqlalchemy.ext.asyncio import AsyncConnection

    from capabilities.log.merkle import Node

TILE: Final = 256
"""Hashes of a full tile, as in C2SP tlog-tiles.

An append changes one row of each level, a proof reads a few.
"""
TILE_LEVELS: Final = 8
"""Levels of the tree that a tile spans: 2^8 is `TILE`."""
FOLLOW_ENTRIES: Final = 256
"""Entries that one transaction takes in: some milliseconds, for which SQLite has no other writer."""


@dataclass(frozen=True, slots=True)
class Search:
    """Question to the index. A column that is None is not asked for.

    Attributes:
        kind, actor, agent, token, object, request, trace: exact; `agent` finds also what that agent did.
        since_ms, until_ms: of the entries' times, until excluded.
        after: number of the entry after which it goes on.
        before: number of the entry before which it looks, from the newest on; None: from the oldest on.
        through: number of the last entry that is looked at.
        most: entries of the answer.
    """

    kind: str | None = None
    actor: str | None = None
    agent: str | None = None
    token: str | None = None
    object: str | None = None
    request: str | None = None
    trace: str | None = None
    since_ms: int | None = None
    until_ms: int | None = None
    after: int = 0
    before: int | None = None
    through: int = 0
    most: int = 100


class Audit:
    """Access of one transaction to the ledger's tree and index."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    # --- reading ---------------------------------------------------------------------------------------------------

    async def followed(self) -> int:
        """Number of entries that are in the tree and the index."""
        return int(await self._connection.scalar(sa.select(t.ledger_followed.c.size)) or 0)

    async def size(self) -> int:
        """Number of entries of the ledger."""
        return int(await self._connection.scalar(sa.select(sa.func.max(t.ledger.c.seq))) or 0)

    async def entry(self, seq: int) -> tuple[bytes, str] | None:
        """Line and hash of an entry."""
        c = t.ledger.c
        row = (await self._connection.execute(sa.select(c.line, c.hash).where(c.seq == seq))).one_or_none()
        return None if row is None else (bytes(row.line), row.hash)

    async def number_of(self, digest: str) -> int | None:
        """Number of the entry with this hash."""
        found: int | None = await self._connection.scalar(sa.select(t.ledger.c.seq).where(t.ledger.c.hash == digest))
        return found

    async def node(self, wanted: Iterable[tuple[int, int]]) -> Node:
        """The nodes of the tree, of these (level, index) pairs: one question for all tiles that they lie in.

        Raises:
            KeyError: by the returned function, for a node that was not wanted.
        """
        places = {(level // TILE_LEVELS, _place(level, index)) for level, index in wanted}
        tiles = dict[tuple[int, int], bytes]()
        c = t.ledger_tiles.c
        for batch in batches(sorted(places)):
            query = sa.select(c.level, c.place, c.hashes).where(sa.tuple_(c.level, c.place).in_(batch))
            tiles |= {(row.level, row.place): bytes(row.hashes) for row in await self._connection.execute(query)}

        def node(level: int, index: int) -> bytes:
            above = level % TILE_LEVELS
            hashes = tiles[level // TILE_LEVELS, _place(level, index)]
            first = (index << above) % TILE * merkle.HASH_BYTES
            return _folded(hashes[first : first + (merkle.HASH_BYTES << above)])

        return node

    async def search(self, asked: Search) -> list[tuple[AuditRow, str, int]]:
        """Rows that meet the question, in its order, each with its entry's hash and length in bytes."""
        c = t.ledger_index.c
        wanted = [
            c[name] == value
            for name in ("kind", "actor", "token", "object", "request", "trace")
            if (value := getattr(asked, name)) is not None
        ]
        if asked.agent is not None:
            wanted.append(sa.or_(c.agent == asked.agent, c.actor == asked.agent))
        if asked.since_ms is not None:
            wanted.append(c.at_ms >= asked.since_ms)
        if asked.until_ms is not None:
            wanted.append(c.at_ms < asked.until_ms)
        if asked.before is not None:
            wanted.append(c.seq < asked.before)
        query = (
            sa.select(t.ledger_index, t.ledger.c.hash, sa.func.length(t.ledger.c.line).label("length"))
            .join(t.ledger, t.ledger.c.seq == c.seq)
            .where(c.seq > asked.after, c.seq <= asked.through, *wanted)
            .order_by(c.seq if asked.before is None else c.seq.desc())
            .limit(asked.most)
        )
        found = (await self._connection.execute(query)).mappings()
        return [(_row(columns), str(columns["hash"]), int(columns["length"])) for columns in found]

    async def lines(self, seqs: Iterable[int]) -> dict[int, bytes]:
        """Lines of these entries, by number."""
        c, found = t.ledger.c, dict[int, bytes]()
        for batch in batches(list(seqs)):
            query = sa.select(c.seq, c.line).where(c.seq.in_(batch))
            found |= {seq: bytes(line) for seq, line in await self._connection.execute(query)}
        return found

    # --- following -------------------------------------------------------------------------------------------------

    async def follow(self) -> int:
        """Takes the next entries into the tree and the index; the number of entries that are in them then.

        Raises:
            ConflictError: another has taken them.
        """
        size = await self.followed()
        c = t.ledger.c
        query = sa.select(c.seq, c.line).where(c.seq > size).order_by(c.seq).limit(FOLLOW_ENTRIES)
        lines = [
            bytes(line)
            for expected, (seq, line) in enumerate(await self._connection.execute(query), start=size + 1)
            if seq == expected
        ]
        if not lines:
            return size
        through = size + len(lines)
        passed = await self._connection.execute(
            sa.update(t.ledger_followed).where(t.ledger_followed.c.size == size).values(size=through)
        )
        if passed.rowcount != 1:
            raise ConflictError
        await self._grow(size, [merkle.leaf_hash(line) for line in lines])
        index = [_columns(row) for row in await self._linked([row_of(line) for line in lines])]
        for batch in batches(index):
            await self._connection.execute(sa.insert(t.ledger_index), batch)
        return through

    async def _grow(self, size: int, fresh: list[bytes]) -> None:
        """Appends hashes to the level-0 tiles, and to each level above those of the tiles that became full."""
        level = 0
        while fresh:
            place, full = size // TILE, list[bytes]()
            c = t.ledger_tiles.c
            here = sa.and_(c.level == level, c.place == place)
            begun = await self._connection.scalar(sa.select(c.hashes).where(here))
            hashes = (b"" if begun is None else bytes(begun)) + b"".join(fresh)
            for at in range(0, len(hashes), TILE * merkle.HASH_BYTES):
                tile = hashes[at : at + TILE * merkle.HASH_BYTES]
                if at == 0 and begun is not None:
                    await self._connection.execute(sa.update(t.ledger_tiles).where(here).values(hashes=tile))
                else:
                    row = {"level": level, "place": place + at // (TILE * merkle.HASH_BYTES), "hashes": tile}
                    await self._connection.execute(sa.insert(t.ledger_tiles).values(row))
                if len(tile) == TILE * merkle.HASH_BYTES:
                    full.append(_folded(tile))
            level, size, fresh = level + 1, size // TILE, full

    async def _linked(self, rows: list[AuditRow]) -> list[AuditRow]:
        """The rows, each with the token, agent and object of the request or hop that it names alone."""
        known = {row.request: row for row in await self._earlier(rows)}
        tokens = await self._tokens_of_hops(row.hop for row in rows if row.token is None and row.hop)
        linked = list[AuditRow]()
        for each in rows:
            row = each
            if row.token is None and row.hop is not None:
                row = replace(row, token=tokens.get(row.hop))
            before = known.get(row.request) if row.request is not None else None
            if before is not None:
                row = replace(
                    row,
                    token=row.token or before.token,
                    agent=row.agent or before.agent,
                    object=row.object or before.object,
                    trace=row.trace or before.trace,
                )
            if row.request is not None and row.token is not None:
                known[row.request] = row
            linked.append(row)
        return linked

    async def _earlier(self, rows: list[AuditRow]) -> list[AuditRow]:
        """The newest earlier row with a token of each request that one of these rows names without."""
        asked = sorted({row.request for row in rows if row.request is not None and row.token is None})
        c, found = t.ledger_index.c, list[AuditRow]()
        for batch in batches(asked):
            query = sa.select(t.ledger_index).where(c.request.in_(batch), c.token.is_not(None)).order_by(c.seq)
            found += [_row(columns) for columns in (await self._connection.execute(query)).mappings()]
        return found

    async def _tokens_of_hops(self, hops: Iterable[str]) -> dict[str, str]:
        c, found = t.hops.c, dict[str, str]()
        for batch in batches(sorted(set(hops))):
            query = sa.select(c.hop_id, c.token_id).where(c.hop_id.in_(batch))
            found |= {hop: token for hop, token in await self._connection.execute(query)}  # noqa: C416 - rows, not pairs
        return found


_COLUMNS: Final = tuple(each.name for each in fields(AuditRow) if each.name != "hop")


def _row(columns: Mapping[Any, Any]) -> AuditRow:
    return AuditRow(**{name: columns[name] for name in _COLUMNS})


def _columns(row: AuditRow) -> dict[str, Any]:
    columns = asdict(row)
    del columns["hop"]
    return columns


def _place(level: int, index: int) -> int:
    """Place of the tile, on its own level, in which a node lies."""
    return (index << level % TILE_LEVELS) // TILE


def _folded(hashes: bytes) -> bytes:
    """Root of the complete subtree over these hashes."""
    nodes = [hashes[at : at + merkle.HASH_BYTES] for at in range(0, len(hashes), merkle.HASH_BYTES)]
    while len(nodes) > 1:
        nodes = [merkle.inner_hash(left, right) for left, right in zip(nodes[::2], nodes[1::2], strict=True)]
    return nodes[0]

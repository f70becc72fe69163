"""Copies of a store in PostgreSQL: read in one snapshot while it serves, put back in one transaction."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import asynccontextmanager, closing, contextmanager
from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from ztpm_idp.domain.locks import EVERYTHING
from ztpm_idp.store import schema as t
from ztpm_idp.store.database import copies, postgres
from ztpm_idp.store.database.copies import UnreadableError
from ztpm_idp.store.database.migrate import NEWEST
from ztpm_idp.store.engine import Store
from ztpm_idp.store.errors import RestoreError, StoreUnavailableError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterable, Iterator
    from pathlib import Path

    from sqlalchemy.ext.asyncio import AsyncConnection

ROWS: Final = 1_000
"""Rows that are in memory at a time."""
_VERSIONS: Final = sa.MetaData()
_VERSION: Final = sa.Table("alembic_version", _VERSIONS, sa.Column("version_num", sa.String(32), primary_key=True))
"""Table of the library that migrates."""


class PostgresPlace:
    """A database of a server.

    Args:
        url: of the settings.
        folder: for the staged file, and for the copy of what was there.
    """

    def __init__(self, url: sa.URL, folder: Path) -> None:
        self._url = url
        self._folder = folder
        self._named = url.render_as_string(hide_password=True)

    def copied_to(self, destination: Path) -> None:
        """As `Place` says, of one snapshot: commands go on meanwhile."""
        with copies.made(destination):
            asyncio.run(self._copied_to(destination))
            with closing(sqlite3.connect(destination)) as copy:
                copies.one_file(copy)
                copies.check_whole(copy, self._named)

    @contextmanager
    def alone(self) -> Iterator[Iterable[bytes]]:
        """As `Place` says: every serving process shares a lock of the server, which is held here alone."""
        with asyncio.Runner() as runner:
            alone = self._alone()
            connection = runner.run(alone.__aenter__())
            try:
                yield _lines(runner, connection)
            finally:
                runner.run(alone.__aexit__(None, None, None))

    @contextmanager
    def staged(self, copy: Path | None) -> Iterator[Path]:
        """As `Place` says."""
        staged = self._folder / f"{self._url.database}.restoring"
        copies.remove(staged)
        if copy is None:
            self.copied_to(staged)
        else:
            copies.copy_file(copy, staged)
        try:
            yield staged
        finally:
            copies.remove(staged)

    def put(self, staged: Path, line: int) -> Path | None:
        """As `Place` says; what was there is copied first."""
        kept = None
        if asyncio.run(self._is_inhabited()):
            kept = copies.unused(self._folder / f"{self._url.database}.before-{line}")
            self.copied_to(kept)
        asyncio.run(self._put(staged))
        return kept

    @asynccontextmanager
    async def _connected(self, **options: Any) -> AsyncIterator[AsyncConnection]:
        """A connection whose statements may take as long as they do."""
        try:
            engine = postgres.engine_of(self._url)
            try:
                async with engine.connect() as connection:
                    yield await connection.execution_options(**options)
            finally:
                await engine.dispose()
        except (SQLAlchemyError, OSError) as error:
            said = str(getattr(error, "orig", None) or error).partition("\n")[0]
            raise RestoreError("UNREADABLE", f"{self._named}: {said}") from error

    @asynccontextmanager
    async def _alone(self) -> AsyncIterator[AsyncConnection]:
        async with self._connected(isolation_level="AUTOCOMMIT") as connection:
            if not await connection.scalar(sa.select(sa.func.pg_try_advisory_lock(postgres.SERVING_LOCK))):
                raise RestoreError("STORE_IN_USE", f"{self._named} is served by another process")
            yield connection

    async def _is_inhabited(self) -> bool:
        """True where the database holds a store with a party in it."""
        async with self._connected() as connection:
            first = sa.select(t.parties.c.id).limit(1)
            return await _has_ledger(connection) and await connection.scalar(first) is not None

    async def _copied_to(self, destination: Path) -> None:
        engine = sa.create_engine(f"sqlite:///{destination}")
        try:
            options = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
            async with self._connected(**options) as connection:
                await postgres.without_limits(connection)
                await self._check_newest(connection)
                with engine.begin() as copy:
                    t.metadata.create_all(copy)
                    _VERSIONS.create_all(copy)
                    copy.execute(sa.insert(_VERSION).values(version_num=NEWEST))
                    for table in t.metadata.sorted_tables:
                        rows = await connection.stream(sa.select(table).order_by(*_order(table)))
                        async for some in rows.mappings().partitions(ROWS):
                            copy.execute(sa.insert(table), [dict(row) for row in some])
        finally:
            engine.dispose()

    async def _check_newest(self, connection: AsyncConnection) -> None:
        found = None
        if await connection.scalar(sa.select(sa.func.to_regclass("alembic_version").is_not(None))):
            found = await connection.scalar(sa.select(_VERSION.c.version_num))
        if found is None:
            raise RestoreError("COPY_UNUSABLE", f"{self._named} is no store of an identity provider")
        if found != NEWEST:
            raise RestoreError("COPY_UNUSABLE", f"{self._named} has schema {found}, this release {NEWEST}: migrate it")

    async def _put(self, staged: Path) -> None:
        await (await Store.open(self._url.render_as_string(hide_password=False))).close()
        engine = sa.create_engine(f"sqlite:///{staged}")
        try:
            async with self._connected() as connection, connection.begin():
                await postgres.without_limits(connection)
                await postgres.take(connection, EVERYTHING)
                names = ", ".join(f'"{table.name}"' for table in t.metadata.sorted_tables)
                await connection.execute(sa.text(f"TRUNCATE {names}"))
                with engine.connect() as copy:
                    for table in t.metadata.sorted_tables:
                        found = copy.execute(sa.select(table).order_by(*_order(table)))
                        for some in found.mappings().partitions(ROWS):
                            await connection.execute(sa.insert(table), [dict(row) for row in some])
        finally:
            engine.dispose()


def _order(table: sa.Table) -> list[sa.Column[Any]]:
    """Columns by which a hop comes after the one above it, and every copy of one store is the same."""
    return [*([t.hops.c.position] if table is t.hops else []), *table.primary_key.columns]


def _lines(runner: asyncio.Runner, connection: AsyncConnection) -> Iterator[bytes]:
    """Lines of the ledger, page by page; none where there is no store."""
    c, after = t.ledger.c, 0

    async def page() -> list[tuple[int, bytes]]:
        query = sa.select(c.seq, c.line).where(c.seq > after).order_by(c.seq).limit(ROWS)
        return [(seq, bytes(line)) for seq, line in await connection.execute(query)]

    try:
        if not runner.run(_has_ledger(connection)):
            return
        while found := runner.run(page()):
            yield from (line for _, line in found)
            after = found[-1][0]
    except (SQLAlchemyError, OSError, StoreUnavailableError) as error:
        raise UnreadableError from error


async def _has_ledger(connection: AsyncConnection) -> bool:
    return bool(await connection.scalar(sa.select(sa.func.to_regclass("ledger").is_not(None))))

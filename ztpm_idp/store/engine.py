"""The database: opened safely, one transaction for each command, storage faults told apart from refusals."""

from __future__ import annotations

import asyncio
import errno
import os
from contextlib import asynccontextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Final, Self

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError, SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncEngine, create_async_engine

from ztpm_idp.store import schema as t
from ztpm_idp.store.errors import ConflictError, NewerDatabaseError, StoreNotOpenedError, StoreUnavailableError
from ztpm_idp.store.migrate import upgrade
from ztpm_idp.store.transaction import Transaction

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

BUSY_TIMEOUT_MS: Final = 5_000
"""Milliseconds for which SQLite waits for another process's write before it is a storage fault."""
PROOF_GRACE_MS: Final = 600_000
"""Milliseconds beyond its life for which a proof id is remembered.

A clock that is set back by less revives no proof.
"""
_SQLITE: Final = "sqlite"


class Store:
    """The identity provider's state. Open it with `Store.open`, close it with `close`."""

    def __init__(self, engine: AsyncEngine) -> None:
        self._engine = engine
        sqlite = engine.dialect.name == _SQLITE
        # SQLite has one writer; waiting here is fair, waiting inside SQLite is not. Other processes are kept out by
        # SQLite itself.
        self._writer: asyncio.Lock | nullcontext[None] = asyncio.Lock() if sqlite else nullcontext()

    @classmethod
    async def open(cls, database_url: str) -> Self:
        """The store at `database_url`, its schema brought to the newest.

        Raises:
            StoreNotOpenedError: it cannot be opened or migrated; with its cause and place.
        """
        engine = create_async_engine(database_url, hide_parameters=True)
        store = cls(engine)
        try:
            if engine.dialect.name == _SQLITE:
                _make_sqlite_safe(engine)
                _make_private(engine.url.database)
            async with store._write_connection() as connection:
                await connection.run_sync(upgrade)
        except (StoreUnavailableError, NewerDatabaseError, OSError) as error:
            await engine.dispose()
            raise _not_opened(error, engine.url) from error
        except BaseException:
            await engine.dispose()
            raise
        return store

    async def close(self) -> None:
        """Every connection is closed."""
        await self._engine.dispose()

    @asynccontextmanager
    async def write(self) -> AsyncIterator[Transaction]:
        """A transaction that is the only one to change state while it lasts.

        Durable when the block has ended without an exception.

        Raises:
            ConflictError: a unique constraint was hit; nothing holds.
            StoreUnavailableError: nothing may be taken to hold.
        """
        async with self._write_connection() as connection:
            transaction = Transaction(connection)
            await transaction.lock()
            yield transaction

    @asynccontextmanager
    async def read(self) -> AsyncIterator[Transaction]:
        """One consistent view; changes nothing.

        Raises:
            StoreUnavailableError: it cannot be read.
        """
        try:
            async with self._engine.connect() as connection:
                if self._engine.dialect.name != _SQLITE:  # SQLite's readers have one snapshot anyway
                    await connection.execution_options(isolation_level="REPEATABLE READ")
                yield Transaction(connection)
        except (SQLAlchemyError, OSError) as error:
            raise StoreUnavailableError from error

    async def first_use(self, *, key: bytes, jti: str, expires_ms: int, at_ms: int) -> bool:
        """True exactly once for each (key, jti), over all processes and restarts. Durable when it returns.

        Args:
            key: raw public key that signed the proof.
            jti: its id.
            expires_ms: when the proof is too old anyway, wall clock.
            at_ms: now; ids that expired long ago are forgotten.

        Raises:
            StoreUnavailableError: it cannot be said, so nothing may be permitted.
        """
        c = t.proofs.c
        try:
            async with self._write_connection() as connection:
                await connection.execute(sa.delete(t.proofs).where(c.forget_ms < at_ms))
                await connection.execute(
                    sa.insert(t.proofs).values(key=key, jti=jti, forget_ms=expires_ms + PROOF_GRACE_MS)
                )  # fmt: skip
        except ConflictError:
            return False
        return True

    async def beat(self) -> None:
        """A change was committed just now: the store can commit.

        Raises:
            StoreUnavailableError: it cannot.
        """
        async with self.write():
            pass

    @asynccontextmanager
    async def _write_connection(self) -> AsyncIterator[Any]:
        try:
            async with self._writer, self._engine.connect() as connection:
                connection = await connection.execution_options(ztpm_writes=True)  # noqa: PLW2901
                async with connection.begin():
                    yield connection
        except IntegrityError as error:
            raise ConflictError from error
        except (SQLAlchemyError, OSError) as error:
            raise StoreUnavailableError from error


def _make_private(path: str | None) -> None:
    """Makes a new database private to its owner from its first instant.

    SQLite gives its log and its index the same mode.
    """
    if path is None or path == ":memory:":
        return
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    except FileExistsError:
        return
    except OSError as error:
        raise StoreUnavailableError from error


def _make_sqlite_safe(engine: AsyncEngine) -> None:
    """Durable commits, enforced references, and transactions that begin where we say.

    WAL with full synchronous: an acknowledged commit survives a power cut (with `NORMAL` it need not). Writers take
    SQLite's write lock at their first statement, so that their reads cannot change before they write.
    """

    @sa.event.listens_for(engine.sync_engine, "connect")
    def _on_connect(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # the driver begins nothing by itself
        cursor = connection.cursor()
        for pragma in (
            "journal_mode = WAL",
            "synchronous = FULL",
            "foreign_keys = ON",
            f"busy_timeout = {BUSY_TIMEOUT_MS}",
        ):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @sa.event.listens_for(engine.sync_engine, "begin")
    def _on_begin(connection: sa.Connection) -> None:
        writes = connection.get_execution_options().get("ztpm_writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def _not_opened(error: Exception, url: sa.URL) -> StoreNotOpenedError:
    place = url.render_as_string(hide_password=True)
    cause = error.__cause__ if isinstance(error, StoreUnavailableError) else error
    said = str(getattr(cause, "orig", None) or cause).partition("\n")[0]
    if isinstance(cause, NewerDatabaseError):
        return StoreNotOpenedError("DATABASE_NEWER", f"{place}: {said}")
    full = "disk is full" in said or getattr(cause, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
    return StoreNotOpenedError("DISK_FULL" if full else "DATABASE_UNUSABLE", f"{place}: {said}")

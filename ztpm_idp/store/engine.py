"""The database: opened safely, one transaction for each command, storage faults told apart from refusals."""

from __future__ import annotations

import asyncio
import errno
import os
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Final, Self

import sqlalchemy as sa
from sqlalchemy.dialects import sqlite
from sqlalchemy.exc import IntegrityError, SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine

from ztpm_idp.domain.locks import EVERYTHING, NO_LOCKS, REVOCATIONS
from ztpm_idp.store import schema as t
from ztpm_idp.store.asking import AskedTogether
from ztpm_idp.store.database import postgres, postgres_trips
from ztpm_idp.store.database.migrate import upgrade
from ztpm_idp.store.database.sqlite_driver import connect
from ztpm_idp.store.errors import (
    AgainError,
    ConflictError,
    NewerDatabaseError,
    ProofUsedError,
    StoreNotOpenedError,
    StoreUnavailableError,
    UnsafeDatabaseError,
)
from ztpm_idp.store.proof_use import ProofUse
from ztpm_idp.store.transaction import Transaction

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.locks import Locks
    from ztpm_idp.domain.parties import Party

BUSY_TIMEOUT_MS: Final = 5_000
"""Milliseconds for which SQLite waits for another process's write before it is a storage fault."""
PROOF_GRACE_MS: Final = 600_000
"""Milliseconds beyond its life for which a proof id is remembered.

A clock that is set back by less revives no proof.
"""
SWEEP_MS: Final = 60_000
"""Milliseconds between two times at which a process forgets old proof ids."""
SWEPT: Final = 2_048
"""Most proof ids that are forgotten at a time, so that nobody waits long for it."""
COMMITTED, ROLLED_BACK, CONFLICT, FAILED = "committed", "rolled-back", "conflict", "failed"
"""Ends of a writing transaction: a refusal rolls back, a conflict is with another transaction, a fault is the rest."""
_P = t.proofs.c
_OLD = (
    sa.select(_P.key, _P.jti)
    .where(_P.forget_ms < sa.bindparam("at_ms"))
    .order_by(_P.forget_ms)
    .limit(SWEPT)
    .with_for_update(skip_locked=True)
)
"""Proof ids to forget, without those that another process is forgetting."""
_FORGET = sa.delete(t.proofs).where(sa.tuple_(_P.key, _P.jti).in_(_OLD))
_USE_UP = sqlite.insert(t.proofs).on_conflict_do_nothing().returning(_P.key, _P.jti)
"""New proof ids, of which those are returned that were new."""
_BEAT = sa.update(t.heartbeat).values(beats=t.heartbeat.c.beats + 1)


class Store:
    """The identity provider's state. Open it with `Store.open`, close it with `close`.

    A process keeps nothing here that another one over the same database would need.

    Attributes:
        before: revision of the schema before it was opened; None of a new database.
        at_once: transactions of several commands that may be under way at a time.
        timed: told that a writing transaction begins; what it gives back is told its end, once.
    """

    def __init__(self, engine: AsyncEngine) -> None:
        self._engine = engine
        self._postgres = engine.dialect.name == postgres.DIALECT
        # One statement is a view, or a transaction, of its own: PostgreSQL is told of no begin and no end of it.
        self._single = engine.execution_options(isolation_level="AUTOCOMMIT") if self._postgres else engine
        # SQLite has one writer; waiting here is fair, waiting inside SQLite is not. Other processes are kept out by
        # SQLite itself.
        self._writer = asyncio.Semaphore(postgres.WRITERS) if self._postgres else asyncio.Lock()
        self.at_once = postgres.WRITERS if self._postgres else 1
        self._swept_ms: int | None = None
        self._uses = AskedTogether(self._first_uses)
        self._owners = AskedTogether(self._parties_of_keys)
        self._epochs = AskedTogether(self._epochs_now)
        self.before: str | None = None
        self.timed: Callable[[], Callable[[str], None]] | None = None

    @classmethod
    async def open(cls, database_url: str) -> Self:
        """The store at `database_url`, its schema brought to the newest; of several that open at once one migrates.

        Raises:
            StoreNotOpenedError: it cannot be opened or migrated; with its cause and place.
        """
        url = sa.make_url(database_url)
        engine: AsyncEngine | None = None
        try:
            engine = postgres.engine_of(url) if url.get_backend_name() == postgres.DIALECT else _sqlite_engine(url)
            store = cls(engine)
            async with store._write_connection(nullcontext()) as connection:
                if store._postgres:
                    await postgres.check_durable(connection)
                    await postgres.wait_for_turn(connection, postgres.MIGRATION_LOCK)
                store.before = await connection.run_sync(upgrade)
        except BaseException as error:
            if engine is not None:
                await engine.dispose()
            if isinstance(error, StoreUnavailableError | NewerDatabaseError | UnsafeDatabaseError | OSError):
                raise _not_opened(error, url) from error
            raise
        return store

    async def close(self) -> None:
        """Every connection is closed."""
        await self._engine.dispose()

    @asynccontextmanager
    async def write(
        self, locks: Locks = EVERYTHING, *, use: ProofUse | None = None, uses: Sequence[ProofUse | None] = ()
    ) -> AsyncIterator[Transaction]:
        """A transaction during which nothing changes of what these locks name, but by itself.

        Durable when the block has ended without an exception.

        Args:
            locks: of `domain.locks`; without any, no other transaction changes state meanwhile.
            use: of the proof that came with the command: it is used up if and only if the rest holds.
            uses: of those that came with several commands, likewise; the transaction's `unused` says of each whether it
                was so far.

        Raises:
            ProofUsedError: that proof was used before; nothing holds.
            ConflictError: a unique constraint was hit; nothing holds.
            AgainError: nothing holds, and the same may be tried again.
            StoreUnavailableError: nothing may be taken to hold.
        """
        # Revocations wait for no place: they are what everybody else waits for.
        urgent = self._postgres and REVOCATIONS in locks.alone
        async with self._write_connection(nullcontext() if urgent else self._writer) as connection:
            transaction = Transaction(connection, locks if self._postgres else None)
            unused = await self._use_up(connection, uses if use is None else [use], locks=locks)
            if use is not None and unused != [True]:
                raise ProofUsedError
            transaction.unused = unused
            yield transaction

    @asynccontextmanager
    async def read(self) -> AsyncIterator[Transaction]:
        """One consistent view; changes nothing.

        Raises:
            StoreUnavailableError: it cannot be read.
        """
        try:
            async with self._engine.connect() as connection:
                if self._postgres:  # SQLite's readers have one snapshot anyway
                    await connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
                yield Transaction(connection, None)
        except (SQLAlchemyError, OSError) as error:
            raise StoreUnavailableError from error

    @asynccontextmanager
    async def glance(self) -> AsyncIterator[Transaction]:
        """A view for one statement: of two, each would see what is newest. Changes nothing.

        Raises:
            StoreUnavailableError: it cannot be read.
        """
        try:
            async with self._single.connect() as connection:
                yield Transaction(connection, None)
        except (SQLAlchemyError, OSError) as error:
            raise StoreUnavailableError from error

    @asynccontextmanager
    async def listening(self, hinted: Callable[[int | None], Awaitable[None]]) -> AsyncIterator[None]:
        """While it lasts, `hinted` is called with the epoch that a process may have reached; None: some may be lost.

        It is a hint that may be lost. Of SQLite there is none: it serves one process.
        """
        if not self._postgres:
            yield
            return
        listener = postgres.Listening(self._engine, hinted)
        try:
            yield
        finally:
            await listener.close()

    async def first_use(self, *, key: bytes, jti: str, expires_ms: int, at_ms: int) -> bool:
        """True exactly once for each (key, jti), over all processes and restarts. Durable when it returns.

        Args:
            key: raw public key that signed the proof.
            jti: its id.
            expires_ms: when the proof is too old anyway, wall clock.
            at_ms: now.

        Raises:
            StoreUnavailableError: it cannot be said, so nothing may be permitted.
        """
        return await self._uses.ask(ProofUse(key, jti, expires_ms, at_ms))

    async def _first_uses(self, uses: Sequence[ProofUse]) -> Sequence[bool]:
        async with self._one_change() as connection:
            return await self._use_up(connection, uses)

    async def party_of_key(self, key: bytes) -> Party | None:
        """Party that owns a key now, ended or not.

        Raises:
            StoreUnavailableError: it cannot be read.
        """
        return await self._owners.ask(key)

    async def epoch(self) -> int:
        """Epoch of a moment after this call.

        Raises:
            StoreUnavailableError: it cannot be read.
        """
        return await self._epochs.ask(None)

    async def _epochs_now(self, asked: Sequence[None]) -> list[int]:
        async with self.glance() as view:
            return [(await view.counters()).epoch] * len(asked)

    async def _parties_of_keys(self, keys: Sequence[bytes]) -> Sequence[Party | None]:
        async with self.glance() as view:
            return await view.parties_of_keys(keys)

    async def _use_up(
        self, connection: AsyncConnection, uses: Sequence[ProofUse | None], *, locks: Locks = NO_LOCKS
    ) -> list[bool]:
        """True for each proof that was unused, and is used up if this transaction commits; also where there is none.

        PostgreSQL holds the locks then, before it looks at any proof.
        """
        every = [use for use in uses if use is not None]
        rows = {(use.key, use.jti): use.expires_ms + PROOF_GRACE_MS for use in every}
        # In one order, so that no two transactions wait for each other.
        given = [(key, jti, forget_ms) for (key, jti), forget_ms in sorted(rows.items())]
        if self._postgres:
            made = await postgres_trips.begin(connection, locks, given)
        else:
            made = await _used_up(connection, given) if given else []
        if every:
            await self._swept(connection, every[0].at_ms)
        new, found = set(made), list[bool]()
        for use in uses:
            found.append(use is None or (use.key, use.jti) in new)
            if use is not None:
                new.discard((use.key, use.jti))  # of two that came with one proof the first one counts
        return found

    async def _swept(self, connection: AsyncConnection, at_ms: int) -> None:
        """Old proof ids are forgotten from time to time."""
        if self._swept_ms is None or not self._swept_ms <= at_ms < self._swept_ms + SWEEP_MS:
            self._swept_ms = at_ms  # one that is rolled back is made up for a minute later
            await connection.execute(_FORGET, {"at_ms": at_ms})

    async def beat(self) -> None:
        """A change was committed just now: the store can commit.

        Raises:
            StoreUnavailableError: it cannot.
        """
        async with self._one_change() as connection:
            await connection.execute(_BEAT)

    @asynccontextmanager
    async def beside(self) -> AsyncIterator[AsyncConnection]:
        """A transaction that writes what no command reads, and locks no row that a command waits for.

        On SQLite, which has one writer, it still has its turn.

        Raises:
            ConflictError: a unique constraint was hit, or the block says so; nothing holds.
            StoreUnavailableError: nothing may be taken to hold.
        """
        async with self._write_connection(nullcontext() if self._postgres else self._writer) as connection:
            yield connection

    def _one_change(self) -> AbstractAsyncContextManager[AsyncConnection]:
        """A connection of which each statement is durable when it has been executed; on SQLite, at the end."""
        return self._write_connection(nullcontext() if self._postgres else self._writer, engine=self._single)

    @asynccontextmanager
    async def _write_connection(
        self, place: AbstractAsyncContextManager[Any], *, engine: AsyncEngine | None = None
    ) -> AsyncIterator[AsyncConnection]:
        ended, end = None if self.timed is None else self.timed(), ROLLED_BACK
        try:
            async with place, (engine or self._engine).connect() as connection:
                connection = await connection.execution_options(ztpm_writes=True)  # noqa: PLW2901
                async with connection.begin():
                    yield connection
            end = COMMITTED
        except IntegrityError as error:
            end = CONFLICT
            raise ConflictError from error
        except (SQLAlchemyError, OSError) as error:
            again = postgres.again(error)
            end = CONFLICT if again else FAILED
            raise (AgainError if again else StoreUnavailableError) from error
        finally:
            if ended is not None:
                ended(end)


async def _used_up(connection: AsyncConnection, uses: list[tuple[bytes, str, int]]) -> list[tuple[bytes, str]]:
    """Those of these proofs that were not used before."""
    given = [{"key": key, "jti": jti, "forget_ms": forget_ms} for key, jti, forget_ms in uses]
    return [(bytes(key), jti) for key, jti in await connection.execute(_USE_UP, given)]


def _sqlite_engine(url: sa.URL) -> AsyncEngine:
    engine = create_async_engine(url, hide_parameters=True, connect_args={"async_creator_fn": connect})
    _make_sqlite_safe(engine)
    _make_private(url.database)
    return engine


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
    if isinstance(cause, UnsafeDatabaseError):
        return StoreNotOpenedError("DATABASE_UNSAFE", f"{place}: {said}")
    full = "disk is full" in said or getattr(cause, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
    return StoreNotOpenedError("DISK_FULL" if full else "DATABASE_UNUSABLE", f"{place}: {said}")

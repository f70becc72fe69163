"""PostgreSQL as the database: connections that are safe, locks by name, and hints that the epoch has grown."""

from __future__ import annotations

import asyncio
import hashlib
import os
import ssl
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.ext.asyncio import create_async_engine

from ztpm_idp.domain.addresses import is_loopback
from ztpm_idp.store.errors import StoreUnavailableError, UnsafeDatabaseError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

    from ztpm_idp.domain.locks import Lock, Locks

DIALECT: Final = "postgresql"
WRITERS: Final = 4
"""Commands of one process that change state at a time.

One waits for the database while another computes; more of them would only hold locks for longer. Revocations and
heartbeats come on top.
"""
CONNECTIONS: Final = 16
"""Connections of one process: `WRITERS`, those who only read, revocations and heartbeats."""
CONNECTION_WAIT_S: Final = 10.0
"""Seconds for which a request waits for a connection."""
CONNECT_S: Final = 10.0
"""Seconds after which a server that does not answer is a storage fault."""
LOCK_TIMEOUT_MS: Final = 15_000
"""Milliseconds for which the server lets a statement wait for another transaction: longer than a frozen one lasts."""
STATEMENT_TIMEOUT_MS: Final = 30_000
"""Milliseconds after which the server ends a statement; migrations and copies have no limit."""
IDLE_TIMEOUT_MS: Final = 10_000
"""Milliseconds after which the server ends a transaction whose process says nothing: a frozen worker holds no lock."""
EPOCH_DIGITS: Final = 18
"""Most digits of an epoch: any number of so many fits the 64 bits of its column."""
EPOCH_CHANNEL: Final = "ztpm_epoch"
"""Channel of the hint that the epoch has grown."""
MIGRATION_LOCK: Final = 0x7A74706D_00000001
"""Advisory lock of migrating ("ztpm" in ASCII)."""
SERVING_LOCK: Final = 0x7A74706D_00000002
"""Advisory lock that every serving process shares, so that nothing is restored under it."""
PUSH_LOCK: Final = 0x7A74706D_00000003
"""Advisory lock of planning what is pushed, so that two workers push nothing twice."""
LISTEN_AGAIN_S: Final = 1.0
"""Seconds after which a listener that lost its connection tries again; until then the pulls find out."""
AGAIN: Final = frozenset({"40001", "40P01"})
"""SQLSTATEs of a transaction that another one was in the way of: serialization failure, deadlock."""
TAKE: Final = (
    "SELECT CASE WHEN alone THEN pg_advisory_xact_lock(number) ELSE pg_advisory_xact_lock_shared(number) END "
    "FROM unnest(CAST(:numbers AS bigint[]), CAST(:alone AS boolean[])) AS lock (number, alone)"
)
"""Statement that takes locks, with the values of `taken`."""
_TAKE: Final = sa.text(TAKE)
_DURABLE: Final = {
    "fsync": {"on"},
    "full_page_writes": {"on"},
    "synchronous_commit": {"on", "remote_write", "remote_apply"},
}
"""Settings of the server with which an acknowledged commit survives a power cut."""


def engine_of(url: sa.URL) -> AsyncEngine:
    """Connections to the server: by TLS with its name verified, unless it is on this machine."""
    return create_async_engine(
        url,
        hide_parameters=True,
        pool_size=CONNECTIONS,
        max_overflow=0,
        pool_timeout=CONNECTION_WAIT_S,
        pool_use_lifo=True,  # few connections that have everything prepared, and not all of them in turn
        connect_args={
            "ssl": _tls(url),
            "timeout": CONNECT_S,
            "server_settings": {
                "application_name": "ztpm-idp",
                "lock_timeout": str(LOCK_TIMEOUT_MS),
                "statement_timeout": str(STATEMENT_TIMEOUT_MS),
                "idle_in_transaction_session_timeout": str(IDLE_TIMEOUT_MS),
                "jit": "off",  # our statements are short: compiling one takes longer than running it
                # One process takes parts of a union one after the other, in the order of each.
                "max_parallel_workers_per_gather": "0",
                # Nor is one planned for each execution: every value finds its rows by the same index.
                "plan_cache_mode": "force_generic_plan",
                "random_page_cost": "1.1",  # no disk that turns: a plan is made once, also while a table is small
            },
        },
    )


def _tls(url: sa.URL) -> ssl.SSLContext | bool:
    """The context for a server beyond this machine; its authority is that of PGSSLROOTCERT, or of the system."""
    if url.host is None or is_loopback(url.host):
        return False
    try:
        return ssl.create_default_context(cafile=os.environ.get("PGSSLROOTCERT") or None)
    except OSError as error:
        raise UnsafeDatabaseError(f"PGSSLROOTCERT: {error.strerror}") from error


async def check_durable(connection: AsyncConnection) -> None:
    """The server forgets no commit that it has acknowledged.

    Raises:
        UnsafeDatabaseError: naming the server's setting.
    """
    for name, safe in _DURABLE.items():
        found = await connection.scalar(sa.select(sa.func.current_setting(name)))
        if found not in safe:
            raise UnsafeDatabaseError(f"the server's {name} is {found}: it could forget what it has acknowledged")


async def wait_for_turn(connection: AsyncConnection, lock: int) -> None:
    """This transaction is the only one that holds this advisory lock, however long another one takes."""
    await without_limits(connection)
    await connection.execute(sa.select(sa.func.pg_advisory_xact_lock(lock)))


async def without_limits(connection: AsyncConnection) -> None:
    """Statements of this transaction, and this process between two of them, may take as long as they do."""
    for name in ("lock_timeout", "statement_timeout", "idle_in_transaction_session_timeout"):
        await connection.execute(sa.text(f"SET LOCAL {name} = 0"))


async def take(connection: AsyncConnection, locks: Locks) -> None:
    """The locks are held until the transaction ends; what is read after that is the newest.

    All take them in one order, in one statement: a list's elements are taken from the first to the last.
    """
    await connection.execute(_TAKE, taken(locks))


def taken(locks: Locks) -> dict[str, list[int] | list[bool]]:
    """Values of the statement that takes these locks."""
    every = sorted(locks.shared | locks.alone)
    return {"numbers": [_number(each) for each in every], "alone": [each in locks.alone for each in every]}


def _number(lock: Lock) -> int:
    """The lock's number, as PostgreSQL names advisory locks. Two with one number would only wait for each other."""
    named = f"{lock.part.value} {lock.id}".encode()
    return int.from_bytes(hashlib.sha256(named).digest()[:8], "big", signed=True)


def again(error: BaseException) -> bool:
    """True where the same transaction may succeed when it is tried again."""
    return isinstance(error, DBAPIError) and getattr(error.orig, "sqlstate", None) in AGAIN


def driver_errors() -> tuple[type[Exception], ...]:
    """Errors of the driver itself, where it is used without SQLAlchemy."""
    import asyncpg

    return (asyncpg.PostgresError, asyncpg.InterfaceError)


class Listening:
    """One connection that holds the lock of a serving process, and hears that another one has revoked.

    A hint that is lost costs a pull's period, never a revocation: rows are the truth, and are read for every hint.

    Args:
        engine: of the store.
        hinted: called with the highest epoch of the hints since its last call; with None when some may be lost.
    """

    def __init__(self, engine: AsyncEngine, hinted: Callable[[int | None], Awaitable[None]]) -> None:
        self._engine = engine
        self._hinted = hinted
        self._task = asyncio.create_task(self._forever())

    async def close(self) -> None:
        """Nothing is heard any more, and the connection is closed."""
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task

    async def _forever(self) -> None:
        while True:
            with suppress(SQLAlchemyError, OSError, StoreUnavailableError):
                async with self._engine.connect() as connection:
                    await self._heard(connection)
            await asyncio.sleep(LISTEN_AGAIN_S)

    async def _heard(self, connection: AsyncConnection) -> None:
        """Returns when the connection is lost."""
        lost, told, epochs = asyncio.Event(), asyncio.Event(), list[int | None]()

        def hint(epoch: int | None) -> None:
            epochs.append(epoch)
            told.set()

        driver: Any = (await connection.get_raw_connection()).driver_connection
        driver.add_termination_listener(lambda _: _set(lost, told))
        try:
            await driver.execute(f"SELECT pg_advisory_lock_shared({SERVING_LOCK})")
            await driver.add_listener(EPOCH_CHANNEL, lambda *heard: hint(_epoch(heard[-1])))
            hint(None)  # of what was committed before
            while not lost.is_set():
                await told.wait()
                told.clear()
                known = [epoch for epoch in epochs if epoch is not None]
                highest = max(known) if len(known) == len(epochs) and known else None
                epochs.clear()
                await self._hinted(highest)
        except driver_errors() as error:
            raise OSError(str(error)) from error
        finally:
            await connection.invalidate()


def _epoch(payload: object) -> int | None:
    """Epoch of a hint; None for one that is no number: every user of the database may send hints."""
    text = str(payload)
    return int(text) if text.isdecimal() and text.isascii() and len(text) <= EPOCH_DIGITS else None


def _set(*events: asyncio.Event) -> None:
    for event in events:
        event.set()

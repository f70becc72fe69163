"""SQLite for SQLAlchemy's asyncio engine: a statement runs where it is asked for, and only what waits has a thread.

A statement of ours takes some twenty microseconds, and being handed to a thread and back takes ten times that;
aiosqlite does so four times for each statement. What may wait for the disk or for another process (a commit, the write
lock) still waits in a thread, so that the loop goes on.
"""

from __future__ import annotations

import asyncio
import sqlite3
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")

PROMPT: Final = ("SELECT", "INSERT", "UPDATE", "DELETE", "WITH")
"""First words of statements that wait for nobody: readers never do, and writers hold the lock already."""
BEGIN: Final = "BEGIN"
"""Beginning of a transaction that reads; it asks for no lock."""
BEGIN_WRITING: Final = "BEGIN IMMEDIATE"
"""Beginning of one that writes; it waits only while another process writes."""


async def connect(database: str, **options: Any) -> SqliteConnection:
    """A connection, as SQLAlchemy's dialect `sqlite+aiosqlite` uses one of aiosqlite.

    Args:
        database: path of the file.
        options: of `sqlite3.connect`.
    """
    shared = {**options, "check_same_thread": False}  # by the loop's thread and those in which it waits, in turn
    return SqliteConnection(await _waited(lambda: sqlite3.connect(database, **shared)))


class SqliteConnection:
    """One connection. Its calls follow each other, as the engine sees to; none begins before the last has ended."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection: sqlite3.Connection | None = connection
        self._tx = self  # the engine hands changes of the isolation level to aiosqlite's queue, which is this

    @property
    def _conn(self) -> sqlite3.Connection:
        if self._connection is None:
            raise ValueError("no active connection")  # the words by which the dialect knows it
        return self._connection

    @property
    def isolation_level(self) -> str | None:
        """Of the driver."""
        return self._conn.isolation_level

    def put_nowait(self, order: tuple[asyncio.Future[Any], Callable[[], Any]]) -> None:
        """Does at once what aiosqlite would do in its thread."""
        future, function = order
        future.set_result(function())

    def cursor(self) -> SqliteCursor:
        """A cursor."""
        return SqliteCursor(self._conn.cursor())

    async def commit(self) -> None:
        """Commits; the data are on disk afterwards."""
        if self._conn.in_transaction:
            await _waited(self._conn.commit)

    async def rollback(self) -> None:
        """Rolls back, which waits for nobody: what was not committed is not on disk."""
        self._conn.rollback()

    async def create_function(self, *arguments: Any, **options: Any) -> None:
        """Makes a function of SQL."""
        self._conn.create_function(*arguments, **options)

    async def close(self) -> None:
        """Closes; a second time does nothing."""
        connection, self._connection = self._connection, None
        if connection is not None:
            await _waited(connection.close)

    def stop(self) -> None:
        """Closes at once, where no loop runs any more."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


class SqliteCursor:
    """One cursor of it."""

    __slots__ = ("_cursor",)

    def __init__(self, cursor: sqlite3.Cursor) -> None:
        self._cursor = cursor

    async def __aenter__(self) -> Self:
        return self

    @property
    def description(self) -> Any:
        """Columns of the last statement's rows; None where it has none."""
        return self._cursor.description

    @property
    def rowcount(self) -> int:
        """Rows that the last statement changed."""
        return self._cursor.rowcount

    @property
    def lastrowid(self) -> int | None:
        """Row that it inserted last."""
        return self._cursor.lastrowid

    @property
    def arraysize(self) -> int:
        """Rows that are fetched at once."""
        return self._cursor.arraysize

    @arraysize.setter
    def arraysize(self, rows: int) -> None:
        self._cursor.arraysize = rows

    async def execute(self, statement: str, parameters: Sequence[Any] = ()) -> None:
        """Runs a statement: in a thread, unless it waits for nobody."""
        if statement.startswith(PROMPT) or statement == BEGIN:
            self._cursor.execute(statement, parameters)
        elif statement != BEGIN_WRITING or not self._has_begun():
            await _waited(lambda: self._cursor.execute(statement, parameters))

    def _has_begun(self) -> bool:
        """True where the write lock was there for the taking; the connection's own patience is as it was."""
        ((patience_ms,),) = self._cursor.execute("PRAGMA busy_timeout").fetchall()
        self._cursor.execute("PRAGMA busy_timeout = 0")
        try:
            self._cursor.execute(BEGIN_WRITING)
        except sqlite3.OperationalError:
            return False
        finally:
            self._cursor.execute(f"PRAGMA busy_timeout = {patience_ms}")
        return True

    async def executemany(self, statement: str, parameters: Sequence[Sequence[Any]]) -> None:
        """Runs a statement for each set of parameters."""
        if statement.startswith(PROMPT):
            self._cursor.executemany(statement, parameters)
        else:
            await _waited(lambda: self._cursor.executemany(statement, parameters))

    async def fetchall(self) -> list[Any]:
        """Rows that are left."""
        return self._cursor.fetchall()

    async def fetchone(self) -> Any:
        """Next row, or None."""
        return self._cursor.fetchone()

    async def fetchmany(self, size: int | None = None) -> list[Any]:
        """Next rows."""
        return self._cursor.fetchmany(self.arraysize if size is None else size)

    async def close(self) -> None:
        """Closes."""
        self._cursor.close()


async def _waited(function: Callable[[], T]) -> T:
    """Result of a call in a thread, which has ended also where the wait for it is cancelled."""
    call = asyncio.get_running_loop().run_in_executor(None, function)
    try:
        return await asyncio.shield(call)
    except asyncio.CancelledError:
        await asyncio.wait([call])
        raise

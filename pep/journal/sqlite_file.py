"""SQLite file of an enforcement point: synced before each answer, damaged ones refused, one transaction at a time."""

from __future__ import annotations

import fcntl
import os
import sqlite3
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, ClassVar, Final

from pep.base.errors import JournalError, PepError, PepFault

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

BUSY_S: Final = 2.0
"""Longest wait for another worker; a transaction takes about a millisecond."""
_SETTINGS: Final = ("PRAGMA journal_mode=WAL", "PRAGMA synchronous=FULL", "PRAGMA trusted_schema=OFF")


class SqliteFile:
    """One file, made when it is missing. Any thread, any number of processes of one machine.

    Args:
        path: of the file, on a local disk; its directory exists.

    Raises:
        PepError: `STATE_UNREADABLE` when it is no such file, or damaged: what it knows would begin anew.

    Attributes:
        WHAT: its name in errors.
        SCHEMA: statements that make what is missing.
    """

    WHAT: ClassVar[str]
    SCHEMA: ClassVar[tuple[str, ...]]

    def __init__(self, path: Path) -> None:
        try:
            with _alone(path.parent):  # two that change a new file to WAL at once would not wait for each other
                os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
                self._begin(sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False))
                sound = self._database.execute("PRAGMA quick_check").fetchone()
        except (OSError, sqlite3.Error) as error:
            raise PepError(PepFault.STATE_UNREADABLE, str(path)) from error
        if sound != ("ok",):
            raise PepError(PepFault.STATE_UNREADABLE, str(path))

    def _begin(self, database: sqlite3.Connection) -> None:
        self._lock = threading.Lock()
        self._database = database
        for statement in (*_SETTINGS, *self.SCHEMA):
            database.execute(statement)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """One transaction that no other worker is in at the same time.

        Raises:
            JournalError: `JOURNAL_BROKEN` when it could not be made durable; nothing of it is.
        """
        with self._lock:
            try:
                self._database.execute("BEGIN IMMEDIATE")
                try:
                    yield
                except BaseException:
                    self._database.execute("ROLLBACK")
                    raise
                self._database.execute("COMMIT")
            except sqlite3.Error as error:
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
                raise JournalError(PepFault.JOURNAL_BROKEN, f"{self.WHAT}: {type(error).__name__}") from error

    def close(self) -> None:
        """The file is closed."""
        with self._lock:
            self._database.close()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """No other process is inside for the same folder; what was made in it is on disk afterwards."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

"""Copies of a store: one file, made of either database while it serves, and put back into either.

The file is a store in SQLite. So nothing of the server's version is needed to make or read one, it is opened and
migrated as any store is, and a provider moves from one database to the other by a copy.
"""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Final, Protocol
from urllib.parse import quote

from ztpm_idp.store.errors import RestoreError, StoreError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from contextlib import AbstractContextManager
    from pathlib import Path

LOGS: Final = ("-wal", "-shm")
"""Ends of the names of the files that SQLite keeps beside a database in use."""


class UnreadableError(StoreError):
    """A ledger that cannot be read to its end."""


class Place(Protocol):
    """Place of a store, of which copies are made and into which one is put."""

    def copied_to(self, destination: Path) -> None:
        """The whole of the store is in this new file of mode 0600, synced.

        Raises:
            RestoreError: nothing is made.
        """
        ...

    def alone(self) -> AbstractContextManager[Iterable[bytes]]:
        """While it lasts nobody else serves the store; the lines of its ledger, as far as they can be read.

        Raises:
            RestoreError: `STORE_IN_USE`.
        """
        ...

    def staged(self, copy: Path | None) -> AbstractContextManager[Path]:
        """The copy, or of None the store itself, in a file of its own that is gone afterwards."""
        ...

    def put(self, staged: Path, line: int) -> Path | None:
        """The staged file's content is the store's, in one step; the file with what was there, if it was anything.

        Args:
            staged: closed by everybody.
            line: that it begins, for the name of the file.
        """
        ...


class SqlitePlace:
    """A file.

    Args:
        file: of the store.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def copied_to(self, destination: Path) -> None:
        """As `Place` says; SQLite copies a database while it is written to."""
        copy_file(self._file, destination)

    @contextmanager
    def alone(self) -> Iterator[Iterable[bytes]]:
        """As `Place` says; the ledger is empty where the file is gone or damaged."""
        if not self._file.exists():
            yield ()
            return
        with closing(_opened(self._file)) as base:
            try:
                one_file(base)
                base.execute("BEGIN IMMEDIATE")  # until the end nobody else opens it as a store
            except sqlite3.DatabaseError as error:
                if error.sqlite_errorcode in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
                    raise RestoreError("STORE_IN_USE", f"{self._file} is open in another process") from None
                yield ()
                return
            yield _lines(base)

    @contextmanager
    def staged(self, copy: Path | None) -> Iterator[Path]:
        """As `Place` says: beside the store, so that it can take its place in one step."""
        staged = self._file.with_name(f"{self._file.name}.restoring")
        remove(staged)  # of an attempt that was killed
        copy_file(self._file if copy is None else copy, staged)
        try:
            yield staged
        finally:
            remove(staged)

    def put(self, staged: Path, line: int) -> Path | None:
        """As `Place` says; the file that was there has another name, too."""
        with closing(_opened(staged)) as whole:
            one_file(whole)
        sync(staged)
        kept, place = None, self._file
        if place.exists():
            kept = unused(place.with_name(f"{place.name}.before-{line}"))
            os.link(place, kept)
            for log in LOGS:  # of a damaged store: beside the new one it would be taken for its own
                beside = place.with_name(place.name + log)
                if beside.exists():
                    beside.rename(kept.with_name(kept.name + log))
        staged.replace(place)
        sync(place)
        return kept


def _lines(base: sqlite3.Connection) -> Iterator[bytes]:
    try:
        for (line,) in base.execute("SELECT line FROM ledger ORDER BY seq"):
            yield bytes(line)
    except (sqlite3.DatabaseError, TypeError) as error:
        raise UnreadableError from error


# --- files -----------------------------------------------------------------------------------------------------------


def copy_file(source: Path, destination: Path) -> None:
    """The whole of one database in a new file, synced."""
    with made(destination):
        try:
            with closing(_opened(source)) as base, closing(_opened(destination)) as copy:
                base.backup(copy)
                one_file(copy)
                check_whole(copy, source)
        except sqlite3.Error as error:
            code = "UNREADABLE" if isinstance(error, sqlite3.OperationalError) else "COPY_UNUSABLE"
            raise RestoreError(code, f"{source}: {error}") from error


@contextmanager
def made(destination: Path) -> Iterator[None]:
    """A new file of mode 0600, which is synced at the end, or gone with a failure.

    Raises:
        RestoreError: `EXISTS`, `UNWRITABLE`.
    """
    try:
        os.close(os.open(destination, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    except FileExistsError:
        raise RestoreError("EXISTS", str(destination)) from None
    except OSError as error:
        raise RestoreError("UNWRITABLE", f"{destination}: {error.strerror}") from error
    try:
        yield
        sync(destination)
    except BaseException:
        remove(destination)
        raise


def check_whole(copy: sqlite3.Connection, source: object) -> None:
    """The file is a whole store.

    Raises:
        RestoreError: `COPY_UNUSABLE`, naming the source.
    """
    if copy.execute("PRAGMA quick_check").fetchall() != [("ok",)]:
        raise RestoreError("COPY_UNUSABLE", f"{source} is damaged")
    if copy.execute("SELECT count(*) FROM sqlite_master WHERE name = 'ledger'").fetchone() != (1,):
        raise RestoreError("COPY_UNUSABLE", f"{source} is no store of an identity provider")


def unused(file: Path) -> Path:
    """This name, or the first with a number after it that no file has."""
    names = (file.with_name(f"{file.name}{more}") for more in ("", *map("-{}".format, range(2, 99))))
    return next(name for name in names if not name.exists())


def remove(file: Path) -> None:
    """Neither the database nor a log of it is there."""
    for name in ("", *LOGS, "-journal"):
        file.with_name(file.name + name).unlink(missing_ok=True)


def one_file(base: sqlite3.Connection) -> None:
    """All of the database is in its one file, which no other process has open.

    Raises:
        sqlite3.OperationalError: another process has it open.
    """
    base.execute("PRAGMA journal_mode = DELETE").fetchone()


def sync(file: Path) -> None:
    """The file and its name are on disk."""
    for place, flags in ((file, os.O_RDWR), (file.parent, os.O_RDONLY | os.O_DIRECTORY)):
        descriptor = os.open(place, flags)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _opened(file: Path) -> sqlite3.Connection:
    """A connection to a database that is there, which answers at once or not at all."""
    return sqlite3.connect(f"file:{quote(str(file))}?mode=rw", uri=True, timeout=0, isolation_level=None)

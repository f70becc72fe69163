"""Stores of admission: the rows of a memory in SQLite, and high-water marks in a small file of their own.

The two are kept apart on purpose. An attacker who can put back an old memory must not be able to put back its mark.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepError, PepFault
from pep.base.files import replace_file
from pep.context.high_water_marks import UNSEEN, HighWaterMark
from pep.context.memory import VALUE_BYTES
from pep.context.memory_rows import MemoryRow

if TYPE_CHECKING:
    from pathlib import Path

TEXT_BYTES: Final = 32_768
"""Longest text of a row that is read; one with the longest names has some 24 kB."""
BUSY_S: Final = 2.0
_MAKE: Final = (
    "CREATE TABLE IF NOT EXISTS memory (sequence INTEGER PRIMARY KEY, text TEXT NOT NULL, value BLOB NOT NULL) STRICT"
)
# One byte more than is allowed, never all of it: a stranger's text may be of any size.
_READ: Final = (
    f"SELECT sequence, substr(CAST(text AS BLOB), 1, {TEXT_BYTES + 1}), "  # noqa: S608 - a number of ours
    f"substr(CAST(value AS BLOB), 1, {VALUE_BYTES + 1}) FROM memory"
)


class MemoryFile:
    """The `Rows` port on one SQLite file, made when it is missing: WAL, and synced with each row. Any thread.

    Args:
        path: of the file; its directory exists.

    Raises:
        PepError: `STATE_UNREADABLE` when it is no such file.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        try:
            os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
            self._database = sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=FULL")
            self._database.execute("PRAGMA trusted_schema=OFF")
            self._database.execute(_MAKE)
        except (OSError, sqlite3.Error) as error:
            raise PepError(PepFault.STATE_UNREADABLE, str(path)) from error

    def append(self, row: MemoryRow) -> None:
        """Appends the row so that it survives a power cut.

        Raises:
            sqlite3.Error: when it does not, or its place is taken.
        """
        with self._lock:
            self._database.execute("INSERT INTO memory VALUES (?, ?, ?)", (row.sequence, row.text, row.value))

    def row(self, sequence: int) -> MemoryRow | None:
        """The row at that place."""
        with self._lock:
            found = self._database.execute(f"{_READ} WHERE sequence = ? LIMIT 1", (sequence,)).fetchone()
        return None if found is None else _row(found)

    def rows(self, *, most: int) -> list[MemoryRow]:
        """At most `most` rows, in the order of their places."""
        with self._lock:
            found = self._database.execute(f"{_READ} ORDER BY sequence LIMIT ?", (most,)).fetchall()
        return [_row(one) for one in found]

    def close(self) -> None:
        """Closes the file."""
        with self._lock:
            self._database.close()


def _row(found: tuple[object, ...]) -> MemoryRow:
    sequence, text, value = found
    return MemoryRow(
        sequence if isinstance(sequence, int) else 0,
        text.decode("utf-8", "replace") if isinstance(text, bytes) else "",
        value if isinstance(value, bytes) else b"",
    )


class HighWaterMarkFile:
    """The `Marks` port on one file, replaced whole and synced.

    Args:
        path: of the file; its directory exists.

    Raises:
        PepError: `STATE_UNREADABLE` when there is one that cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        try:
            stored = json.loads(path.read_bytes())
            self._marks = {
                str(name): HighWaterMark(int(version), str(digest)) for name, (version, digest) in stored.items()
            }
        except FileNotFoundError:
            self._marks = {}
        except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
            raise PepError(PepFault.STATE_UNREADABLE, str(path)) from error

    def read(self, name: str) -> HighWaterMark:
        """The mark, `UNSEEN` when there never was one."""
        with self._lock:
            return self._marks.get(name, UNSEEN)

    def write(self, name: str, mark: HighWaterMark) -> None:
        """Writes the mark so that it survives a power cut.

        Raises:
            PepError: `STATE_UNREADABLE` when it could not be made durable.
        """
        with self._lock:
            marks = {**self._marks, name: mark}
            content = {key: [held.version, held.digest] for key, held in sorted(marks.items())}
            try:
                replace_file(self._path, json.dumps(content).encode())
            except OSError as error:
                raise PepError(PepFault.STATE_UNREADABLE, str(self._path)) from error
            self._marks = marks

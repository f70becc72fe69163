"""The PEP's own durable journal: JSON lines, chained by hash, on disk before anything moves.

A record is one line of RFC 8785 JSON: `{"v":1,"pep":id,"seq":n,"prev":hex,"at_ms":wall,"kind":...,"body":{...}}`. Its
hash is SHA-256 over exactly the line's bytes; `prev` of the first is 64 zeros. A line that was being written when the
power failed has no newline: it was never acknowledged and is cut off when the journal is opened again. Any other damage
is refused, since it is no accident of writing. The chain holds every record but the newest; the ledger holds that one.

A note is a record that nothing waits for. It is in the file at once, so it outlives this process; a power cut may take
it until it is settled: by the next record that is waited for, or by `settle`. The ledger is not told of it before.
"""

from __future__ import annotations

import array
import bisect
import contextlib
import fcntl
import hashlib
import json
import os
import threading
from typing import TYPE_CHECKING, Any, Final

from capabilities.values import strict_json
from capabilities.values.errors import StatementError
from pep.base.errors import JournalError, PepFault

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from pep.base.ports import Clock

FIRST_PREV: Final = "0" * 64
FIRST_SEQ: Final = 1
VERSION: Final = 1


def record_hash(line: bytes) -> str:
    """The hash (hex) of a record, from its line without the newline."""
    return hashlib.sha256(line).hexdigest()


class FileJournal:
    """The `Journal` port on one file. One process at a time; any thread.

    Attributes:
        repaired_bytes: length of the torn tail that opening cut off; 0 when there was none.
    """

    def __init__(self, descriptor: int, *, pep_id: str, clock: Clock) -> None:
        self._fd = descriptor
        self._pep_id = pep_id
        self._clock = clock
        # `_lock` is held over a line, never over a sync: a note waits for no other record's disk.
        self._lock = threading.Lock()
        self._syncing = threading.Lock()
        self._settled = 0
        self._starts = array.array("Q")
        self._size = 0
        self._head = FIRST_PREV
        self._broken = False
        self.repaired_bytes = 0

    @classmethod
    def open(cls, path: Path, *, pep_id: str, clock: Clock) -> FileJournal:
        """The journal at `path`, its chain verified to the last record, ready to append; made when missing.

        Args:
            path: of the file; its directory exists.
            pep_id: stands in every record.
            clock: its wall time stands in every record.

        Raises:
            JournalError: `JOURNAL_LOCKED` when another process has it open, `JOURNAL_CORRUPT` when a whole record is
                damaged.
        """
        descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)
        journal = cls(descriptor, pep_id=pep_id, clock=clock)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise JournalError(PepFault.JOURNAL_LOCKED, str(path)) from error
            journal._recover()
            # What a process left that was killed was perhaps never synced.
            os.fdatasync(descriptor)
            journal._settled = len(journal._starts)
            directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(directory)
            finally:
                os.close(directory)
        except BaseException:
            os.close(descriptor)
            raise
        return journal

    def _recover(self) -> None:
        with os.fdopen(os.dup(self._fd), "rb") as file:
            file.seek(0)
            for line in file:
                if not line.endswith(b"\n"):
                    self.repaired_bytes = len(line)
                    break
                self._adopt(line[:-1])
        if self.repaired_bytes:
            os.ftruncate(self._fd, self._size)
            os.fsync(self._fd)

    def _adopt(self, line: bytes) -> None:
        seq = FIRST_SEQ + len(self._starts)
        try:
            record = json.loads(line)
            states = (record["v"], record["pep"], record["seq"], record["prev"])
            sound = states == (VERSION, self._pep_id, seq, self._head) and strict_json.canonical(record) == line
        except (ValueError, KeyError, TypeError, RecursionError, StatementError) as error:
            raise JournalError(PepFault.JOURNAL_CORRUPT, f"record {seq} is unreadable") from error
        if not sound:
            raise JournalError(PepFault.JOURNAL_CORRUPT, f"record {seq} breaks the chain")
        self._starts.append(self._size)
        self._size += len(line) + 1
        self._head = record_hash(line)

    def append(self, kind: str, body: dict[str, object]) -> str:
        """The record's hash (hex); it survives a power cut.

        Args:
            kind: "advice", "decision", "outcome", "refusal", "ask", "ask-answered", "ask-refused", "ask-expired",
                "incident", "latched", "latch-retreat", "latch-cleared", "lease", "lease-ended",
                "lease-renewed", "picture", "stop", "stream", "stream-values" or "ticket".
            body: plain JSON values, finite numbers.

        Raises:
            JournalError: `JOURNAL_BROKEN` when it could not be made durable. After a failed write or sync every later
                append raises too: what the disk then holds is known again only after opening anew.
        """
        digest, through = self._written(kind, body)
        self._settle(through)
        return digest

    def note(self, kind: str, body: dict[str, object]) -> str:
        """The record's hash (hex); it outlives this process, and a power cut once it is settled.

        Args:
            kind: as for `append`.
            body: likewise.

        Raises:
            JournalError: `JOURNAL_BROKEN` when it could not be written.
        """
        return self._written(kind, body)[0]

    def settle(self) -> None:
        """All that is in the file survives a power cut.

        Raises:
            JournalError: `JOURNAL_BROKEN`, as `append`.
        """
        self._settle(len(self._starts))

    def _written(self, kind: str, body: dict[str, object]) -> tuple[str, int]:
        """The record's hash and its place, counted from 1."""
        with self._lock:
            if self._broken:
                raise JournalError(PepFault.JOURNAL_BROKEN, "an earlier write failed")
            record = {
                "v": VERSION,
                "pep": self._pep_id,
                "seq": FIRST_SEQ + len(self._starts),
                "prev": self._head,
                "at_ms": int(self._clock.wall_s() * 1000),
                "kind": kind,
                "body": body,
            }
            try:
                line = strict_json.canonical(record)  # a value that is no JSON raises here
            except StatementError as error:
                raise JournalError(PepFault.JOURNAL_BROKEN, "the record is no plain JSON") from error
            try:
                self._write(line + b"\n")
            except OSError as error:
                self._broken = True
                raise JournalError(PepFault.JOURNAL_BROKEN, type(error).__name__) from error
            self._starts.append(self._size)
            self._size += len(line) + 1
            self._head = record_hash(line)
            return self._head, len(self._starts)

    def _settle(self, through: int) -> None:
        """The first so many records survive a power cut; one sync serves all that are in the file by then."""
        with self._syncing:
            if self._settled >= through:
                return
            if self._broken:
                raise JournalError(PepFault.JOURNAL_BROKEN, "an earlier write failed")
            written = len(self._starts)
            try:
                os.fdatasync(self._fd)
            except OSError as error:
                self._broken = True
                raise JournalError(PepFault.JOURNAL_BROKEN, type(error).__name__) from error
            self._settled = written

    def _write(self, line: bytes) -> None:
        view = memoryview(line)
        while view:
            view = view[os.write(self._fd, view) :]

    @property
    def last_seq(self) -> int:
        """Number of the newest record; 0 when there is none."""
        return FIRST_SEQ + len(self._starts) - 1

    @property
    def settled(self) -> bool:
        """False while a note waits for its disk."""
        return self._settled == len(self._starts)

    def after(self, seq: int, *, most_bytes: int) -> list[bytes]:
        """Lines of the settled records that follow number `seq`, oldest first, as many as fit into `most_bytes`.

        It is at least one if there is any.
        """
        return self._read(seq, self._settled, most_bytes)

    def _read(self, seq: int, through: int, most_bytes: int) -> list[bytes]:
        """Lines of the records that follow number `seq`, up to the one of that place, counted from 1."""
        with self._lock:
            first = seq + 1 - FIRST_SEQ
            if first >= through:
                return []
            ends = self._starts[first + 1 : through + 1]
            if len(ends) < through - first:
                ends.append(self._size)
            start = self._starts[first]
            count = max(1, bisect.bisect_right(ends, start + most_bytes))
            span = os.pread(self._fd, ends[count - 1] - start, start)
        return span.splitlines()

    def records(self) -> Iterator[dict[str, Any]]:
        """Every record from the first, as they are in the file now."""
        seq = FIRST_SEQ - 1
        while batch := self._read(seq, len(self._starts), 1 << 20):
            yield from map(json.loads, batch)
            seq += len(batch)

    def close(self) -> None:
        """The file is settled, closed and unlocked; later appends raise."""
        with contextlib.suppress(JournalError):  # broken: what the disk holds is known again only after opening anew
            self.settle()
        with self._syncing, self._lock:
            self._broken = True
            os.close(self._fd)

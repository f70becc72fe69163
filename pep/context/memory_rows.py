"""Rows of a memory: which are ours, and which names a damaged store can no longer answer.

Every row names the one before it ([STM-12] in docs/spec.md), and the newest is remembered apart from them. So a row
that was changed, forged or taken out shows, and so does a store that was put back. A row before such a place is not
believed: a newer row of the same name may have stood there.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.keys import keys
from capabilities.statements.context import memory
from capabilities.values.errors import CapabilityError
from pep.context.collection import Incident
from pep.context.high_water_marks import UNSEEN, HighWaterMark

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.context.memory import Remembered
    from capabilities.values.caps import Caps

ROWS: Final = 16_384
"""Most rows of a memory: opening it checks each, at about 0.2 ms."""


class MemoryFault(StrEnum):
    """Reason why a value was not written, or is not believed."""

    NAME_MALFORMED = "NAME_MALFORMED"
    VALUE_TOO_LARGE = "VALUE_TOO_LARGE"
    NOT_WRITABLE = "NOT_WRITABLE"
    """Too many or too long names behind it for any row: it would never be read again."""
    FULL = "FULL"
    ABSENT = "ABSENT"
    """Nothing of that name was ever written."""
    ROW_MISSING = "ROW_MISSING"
    ROW_FORGED = "ROW_FORGED"
    """Not signed by this enforcement point, or not the row that stood there."""
    VALUE_CHANGED = "VALUE_CHANGED"
    ROLLED_BACK = "ROLLED_BACK"
    """A later row is missing or forged; it could have been of this name."""
    WRITER_REVOKED = "WRITER_REVOKED"
    REVOCATION_VIEW_STALE = "REVOCATION_VIEW_STALE"
    STORE_FAILED = "STORE_FAILED"


@dataclass(frozen=True, slots=True)
class MemoryRow:
    """One row as a store holds it, unverified: its place, the signed text, and the value's canonical JSON."""

    sequence: int
    text: str
    value: bytes


class MemoryRows(Protocol):
    """Store of a memory. Either call may raise any error of the store."""

    def append(self, row: MemoryRow) -> None:
        """Appends the row so that it survives a power cut; a sequence that is taken raises."""
        ...

    def row(self, sequence: int) -> MemoryRow | None:
        """The row at that place."""
        ...

    def rows(self, *, most: int) -> Iterable[MemoryRow]:
        """At most `most` rows, in the order of their places."""
        ...


@dataclass(frozen=True, slots=True)
class Owner:
    """Owner of a memory: rows count that this key signed for this enforcement point's canonical URL."""

    key: PrivateKey
    audience: str
    caps: Caps

    def authentic(self, row: MemoryRow) -> Remembered | MemoryFault:
        """Content of a row that is ours, in its place and with its value; else its fault."""
        try:
            found = memory.open(row.text, frozenset({keys.public_raw(self.key)}), self.caps)
        except CapabilityError:
            return MemoryFault.ROW_FORGED
        if found.audience != self.audience or found.sequence != row.sequence:
            return MemoryFault.ROW_FORGED
        if hashlib.sha256(row.value).hexdigest() != found.value:
            return MemoryFault.VALUE_CHANGED
        return found


class History:
    """All rows of a memory, judged once when it is opened, and those written since. Its owner locks it.

    Args:
        rows: as the store returns them.
        owner: owner of the rows.
        seen: the newest that was ever written.

    Attributes:
        head: the newest row; what is written next follows it.
        broken: the last place that was not ours when the memory was opened, 0 for none.
        places: number and digest of the newest row by name.
        written: rows by writer.
    """

    def __init__(self, rows: Iterable[MemoryRow], owner: Owner, *, seen: HighWaterMark) -> None:
        self.head: HighWaterMark = UNSEEN
        self.broken = 0
        self.places: dict[str, HighWaterMark] = {}
        self.written: dict[str, int] = {}
        self._noted: dict[Incident, None] = {}
        before = HighWaterMark(0, memory.FIRST_PREVIOUS)
        for row in rows:
            found = owner.authentic(row)
            if isinstance(found, MemoryFault):
                self.note(row.sequence, found)
                continue
            if row.sequence <= before.version:
                # One of our rows a second time, behind a newer one.
                self.note(row.sequence, MemoryFault.ROLLED_BACK)
                continue
            if before.version + 1 < row.sequence:
                self._missing(before.version + 1, row.sequence)
            elif found.previous != before.digest:
                # Two histories of one memory, both ours: an older state was put back and written to.
                self.note(row.sequence, MemoryFault.ROLLED_BACK)
                self.broken = row.sequence
            before = HighWaterMark(row.sequence, digest_of(row.text))
            if row.sequence == seen.version and before.digest != seen.digest:
                self.note(row.sequence, MemoryFault.ROLLED_BACK)
                self.broken = row.sequence + 1
            self.adopt(found.name, found.writer, before)
        if before.version < seen.version:
            # What is written from here on follows the newest that there ever was: no place is filled twice.
            self._missing(before.version + 1, seen.version + 1)
            self.head = seen

    def adopt(self, name: str, writer: str, head: HighWaterMark) -> None:
        """Takes the row at `head` as the newest, and the newest of its name."""
        self.places[name] = head
        self.written[writer] = self.written.get(writer, 0) + 1
        self.head = head

    def note(self, place: int, fault: MemoryFault) -> None:
        """Notes the fault of a place as an incident, once for all readings of a damaged row."""
        self._noted[Incident(fault, str(place))] = None

    @property
    def incidents(self) -> tuple[Incident, ...]:
        """Faults of the store when it was opened, and those found since."""
        return tuple(self._noted)

    def _missing(self, first: int, end: int) -> None:
        for place in range(first, end):
            self.note(place, MemoryFault.ROW_MISSING)
        self.broken = end - 1


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a row's text, which the next row names."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

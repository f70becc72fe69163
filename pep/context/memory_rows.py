"""The rows of a memory: which of them are ours, and what a store that was tampered with can no longer say.

Every row names the one before it ([STM-12] in docs/spec.md), and the newest is remembered apart from them. So a row
that was changed, forged or taken out shows, and a store that was put back does. What stands before such a place is not
believed: a newer row of the same name may have stood there.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.keys import keys
from capabilities.statements import memory
from capabilities.values.errors import CapabilityError
from pep.context.collection import Incident
from pep.context.high_water_marks import UNSEEN, HighWaterMark

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.memory import Remembered
    from capabilities.values.caps import Caps

ROWS: Final = 16_384
"""Most rows of a memory: opening it checks each, at about 0.2 ms."""


class MemoryFault(StrEnum):
    """Why something was not written, or is not believed."""

    NAME_MALFORMED = "NAME_MALFORMED"
    VALUE_TOO_LARGE = "VALUE_TOO_LARGE"
    NOT_WRITABLE = "NOT_WRITABLE"
    """Names behind it that no row can hold: it would never be read again."""
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
    """One row as a store holds it: its place, the signed text, and the value's canonical JSON. Nothing is believed."""

    sequence: int
    text: str
    value: bytes


class MemoryRows(Protocol):
    """The store of a memory. Either call may raise whatever the store raises."""

    def append(self, row: MemoryRow) -> None:
        """The row survives a power cut; a sequence that is taken raises."""
        ...

    def row(self, sequence: int) -> MemoryRow | None:
        """The row at that place."""
        ...

    def rows(self, *, most: int) -> Iterable[MemoryRow]:
        """At most `most` rows, in the order of their places."""
        ...


@dataclass(frozen=True, slots=True)
class Owner:
    """Whose rows count: those that this key signed for this enforcement point's canonical URL."""

    key: PrivateKey
    audience: str
    caps: Caps

    def authentic(self, row: MemoryRow) -> Remembered | MemoryFault:
        """What a row says, when it is ours, stands where it says and holds the value that it names."""
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
    """All rows of a memory, judged once when it is opened, and what was written since. Its owner locks it.

    Args:
        rows: as the store returns them.
        owner: whose they should be.
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
                # One of our rows a second time, behind a newer one whose place it would take.
                self.note(row.sequence, MemoryFault.ROLLED_BACK)
                continue
            if before.version + 1 < row.sequence:
                self._missing(before.version + 1, row.sequence)
            elif found.previous != before.digest:
                # Two histories of one memory, both ours: somebody has put back what we went on from.
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
        """The row at `head` is the newest, and the newest of its name."""
        self.places[name] = head
        self.written[writer] = self.written.get(writer, 0) + 1
        self.head = head

    def note(self, place: int, fault: MemoryFault) -> None:
        """The fault of a place is an incident, once: whoever reads a damaged row again makes no more of it."""
        self._noted[Incident(fault, str(place))] = None

    @property
    def incidents(self) -> tuple[Incident, ...]:
        """What was wrong with the store when it was opened, and what was found since."""
        return tuple(self._noted)

    def _missing(self, first: int, end: int) -> None:
        for place in range(first, end):
            self.note(place, MemoryFault.ROW_MISSING)
        self.broken = end - 1


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a row's text: what the next row names."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

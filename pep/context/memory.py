"""A memory with authority: who may write is in the writer's token, and what was written is believed for who wrote it.

A write needs the grant ("memory", "remember") at every hop of the writer's verified chain. It is one row, signed with
this enforcement point's key, that names the row before it ([STM-12] in docs/spec.md). The store is not trusted: a row
that was changed, forged or taken out, and a store that was put back, show when the memory is opened and at each read.
What is read has at most the integrity of a record, the taint that it was written with, and its age; it is content.

Nothing is taken out of a memory but with all of it: what was overwritten stays behind as evidence.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol

from capabilities import keys, text
from capabilities.errors import CapabilityError
from capabilities.scope import Tier
from capabilities.statements import admission, memory
from capabilities.statements.claims import TEXT_BYTES
from capabilities.statements.revocation import named
from pep.context import value as values
from pep.context.marks import UNSEEN, Mark
from pep.context.retrieval import Incident, shown
from pep.context.value import Plain
from pep.errors import PepError, PepFault
from policies.labels import NOBODY, Integrity, Label, Source, aged, joined
from policies.said import ItemKind, ItemReading

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.caps import Caps
    from capabilities.chain import Chain, Refusal
    from capabilities.errors import Fault
    from capabilities.keys import PrivateKey
    from capabilities.statements.memory import Remembered
    from capabilities.verify import Verifier
    from pep.context.marks import Marks
    from pep.ports import Clock, RevocationFeed

OBJECT: Final = "memory"
OPERATION: Final = "remember"
"""The grant that a write needs. It has no parameters: a token lends the memory or does not."""
VALUE_BYTES: Final = 16_384
"""Largest value in canonical JSON: notes and poses; what is longer is a document."""
ROWS: Final = 16_384
"""Most rows of a memory: opening it checks each, at about 0.2 ms."""
ROWS_OF_A_WRITER: Final = 4_096
"""Most rows of one agent, so that one that writes without end fills its own part."""
MARK_NAME: Final = "memory"


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
class Row:
    """One row as a store holds it: its place, the signed text, and the value's canonical JSON. Nothing is believed."""

    sequence: int
    text: str
    value: bytes


class Rows(Protocol):
    """The store of a memory. Either call may raise whatever the store raises."""

    def append(self, row: Row) -> None:
        """The row survives a power cut; a sequence that is taken raises."""
        ...

    def row(self, sequence: int) -> Row | None:
        """The row at that place."""
        ...

    def rows(self, *, most: int) -> Iterable[Row]:
        """At most `most` rows, in the order of their places."""
        ...


@dataclass(frozen=True, slots=True)
class Written:
    """What was written. `digest` is the SHA-256 (hex) of the row's text, for the record."""

    sequence: int
    digest: str


@dataclass(frozen=True, slots=True)
class Recalled:
    """What was read: what admission may know of it, and its value; None when its provenance is not believed."""

    reading: ItemReading
    value: Plain | None


class Memory:
    """The memory of one enforcement point. Any thread.

    Args:
        rows: the store.
        marks: the newest row that was ever written; not in that store.
        key: of this enforcement point.
        audience: its canonical URL.
        verifier: that verified the writers' chains.
        feed: what is revoked.
        clock: wall time.
        caps: the bounds.

    Raises:
        PepError: `STATE_UNREADABLE` when store or mark cannot be read.
    """

    def __init__(
        self,
        rows: Rows,
        *,
        marks: Marks,
        key: PrivateKey,
        audience: str,
        verifier: Verifier,
        feed: RevocationFeed,
        clock: Clock,
        caps: Caps,
    ) -> None:
        self._rows = rows
        self._marks = marks
        self._key = key
        self._mine = frozenset({keys.public_raw(key)})
        self._audience = audience
        self._verifier = verifier
        self._feed = feed
        self._clock = clock
        self._caps = caps
        self._lock = threading.Lock()
        self._head: Mark = UNSEEN
        self._broken = 0
        """The last place that was not ours when the memory was opened; what stands before it may have been replaced."""
        self._places: dict[str, Mark] = {}
        self._written: dict[str, int] = {}
        self._failed = False
        self._noted: dict[Incident, None] = {}
        self._open()

    def remember(
        self, name: str, value: Plain, *, label: Label, chain: Chain
    ) -> Written | MemoryFault | Refusal | Fault:
        """The value is remembered under the name, on disk; or why not, and then nothing was written.

        Args:
            name: of the grammar of names.
            value: at most `VALUE_BYTES`.
            label: of the value: that of the context which it comes out of (`Flow.label`).
            chain: the writer's, verified just now by `verifier`, after its proof of possession.

        Returns:
            The row; or a fault of this module, or what the chain (or its verifier) says against it.

        Raises:
            PepError: `STATE_UNREADABLE` when it could not be made durable. Nothing more is written then until the
                memory is opened anew: what the store holds is known again only after that.
        """
        # 1 what would be written, before anything that costs
        try:
            text.name(name, most_bytes=TEXT_BYTES)
        except CapabilityError:
            return MemoryFault.NAME_MALFORMED
        if len(value.raw) > VALUE_BYTES:
            return MemoryFault.VALUE_TOO_LARGE
        # 2 the writer's authority, at every hop
        at = self._clock.wall_s()
        refused = self._verifier.check_request(
            chain, object=OBJECT, operation=OPERATION, values=(), base_tier=Tier.NO_EFFECT, at=at
        )
        if refused is not None:
            return refused
        # 3 one row after all others, then the mark: a power cut between the two loses nothing and hides nothing
        with self._lock:
            writer = chain.leaf.agent
            if self._head.version >= ROWS or self._written.get(writer, 0) >= ROWS_OF_A_WRITER:
                return MemoryFault.FULL
            signed = memory.sign(self._row_of(name, value, label=label, chain=chain, at=at), self._key)
            head = Mark(self._head.version + 1, _digest(signed))
            row = Row(head.version, signed, value.raw)
            if isinstance(self._authentic(row), MemoryFault):
                return MemoryFault.NOT_WRITABLE
            self._keep(row, head)
            self._adopt(name, writer, head)
            return Written(head.version, head.digest)

    def recall(self, name: str, *, lease_ms: int) -> Recalled:
        """What was last remembered under the name, verified anew; or why it is not believed.

        Args:
            name: as it was written.
            lease_ms: oldest acceptable revocation view.
        """
        with self._lock:
            place, broken = self._places.get(name), self._broken
        if place is None:
            return _lost(name, MemoryFault.ROLLED_BACK if broken else MemoryFault.ABSENT)
        if place.version < broken:
            return _lost(name, MemoryFault.ROLLED_BACK)
        try:
            row = self._rows.row(place.version)
        except Exception:  # noqa: BLE001 - whatever a store raises, nothing was read
            return _lost(name, MemoryFault.STORE_FAILED)
        found = MemoryFault.ROW_MISSING if row is None else self._authentic(row)
        if isinstance(found, MemoryFault) or row is None or _digest(row.text) != place.digest:
            fault = found if isinstance(found, MemoryFault) else MemoryFault.ROW_FORGED
            self._note(place.version, fault)
            return _lost(name, fault)
        value = values.read(row.value)
        if not isinstance(value, Plain):
            return _lost(name, MemoryFault.VALUE_CHANGED)
        view = self._feed.view()
        if view.age_ms > lease_ms:
            return _lost(name, MemoryFault.REVOCATION_VIEW_STALE)
        if not view.revoked.isdisjoint(found.behind):
            return _lost(name, MemoryFault.WRITER_REVOKED)
        reading = ItemReading(ItemKind.MEMORY, name, self._label(found), writer_authorised=True)
        return Recalled(reading, value)

    # --- opening -----------------------------------------------------------------------------------------------------

    def _open(self) -> None:
        try:
            rows = list(self._rows.rows(most=ROWS + 1))
        except Exception as error:
            raise PepError(PepFault.STATE_UNREADABLE, "the memory cannot be read") from error
        seen = self._marks.read(MARK_NAME)
        before = Mark(0, memory.FIRST_PREVIOUS)
        for row in rows:
            found = self._authentic(row)
            if isinstance(found, MemoryFault):
                self._note(row.sequence, found)
                continue
            if row.sequence <= before.version:
                # One of our rows a second time, behind a newer one whose place it would take.
                self._note(row.sequence, MemoryFault.ROLLED_BACK)
                continue
            if before.version + 1 < row.sequence:
                self._missing(before.version + 1, row.sequence)
            elif found.previous != before.digest:
                # Two histories of one memory, both ours: somebody has put back what we went on from.
                self._note(row.sequence, MemoryFault.ROLLED_BACK)
                self._broken = row.sequence
            before = Mark(row.sequence, _digest(row.text))
            if row.sequence == seen.version and before.digest != seen.digest:
                self._note(row.sequence, MemoryFault.ROLLED_BACK)
                self._broken = row.sequence + 1
            self._adopt(found.name, found.writer, before)
        if before.version < seen.version:
            # What is written from here on follows the newest that there ever was: no place is filled twice.
            self._missing(before.version + 1, seen.version + 1)
            before = seen
        self._head = before if before.version else UNSEEN

    def _missing(self, first: int, end: int) -> None:
        """From `first` up to and without `end` no row is ours: what stands before may have been replaced there."""
        for place in range(first, end):
            self._note(place, MemoryFault.ROW_MISSING)
        self._broken = end - 1

    def _authentic(self, row: Row) -> Remembered | MemoryFault:
        """What a row says, when it is ours, stands where it says and holds the value that it names."""
        try:
            found = memory.open(row.text, self._mine, self._caps)
        except CapabilityError:
            return MemoryFault.ROW_FORGED
        if found.audience != self._audience or found.sequence != row.sequence:
            return MemoryFault.ROW_FORGED
        if hashlib.sha256(row.value).hexdigest() != found.value:
            return MemoryFault.VALUE_CHANGED
        return found

    def _note(self, place: int, fault: MemoryFault) -> None:
        # Once each: whoever reads a damaged row again and again makes no more of it.
        self._noted[Incident(fault, str(place))] = None

    @property
    def incidents(self) -> tuple[Incident, ...]:
        """What was wrong with the store when it was opened, and what was found since, by sequence."""
        return tuple(self._noted)

    def _adopt(self, name: str, writer: str, head: Mark) -> None:
        self._places[name] = head
        self._written[writer] = self._written.get(writer, 0) + 1
        self._head = head

    # --- writing -----------------------------------------------------------------------------------------------------

    def _row_of(self, name: str, value: Plain, *, label: Label, chain: Chain, at: float) -> Remembered:
        return memory.Remembered(
            audience=self._audience,
            sequence=self._head.version + 1,
            previous=self._head.digest or memory.FIRST_PREVIOUS,
            name=name,
            value=value.digest,
            writer=chain.leaf.agent,
            hop_id=chain.leaf.hop_id,
            token_id=chain.token_id,
            behind=tuple(sorted(named(chain))),
            sources=tuple(sorted(map(str, label.sources))),
            signers=tuple(sorted(label.signers)),
            integrity=admission.INTEGRITIES[label.integrity],
            age_ms=label.age_ms,
            tainted=label.tainted,
            at=int(at),
        )

    def _keep(self, row: Row, head: Mark) -> None:
        if self._failed:
            raise PepError(PepFault.STATE_UNREADABLE, "an earlier write failed")
        try:
            self._rows.append(row)
            self._marks.write(MARK_NAME, head)
        except Exception as error:
            self._failed = True
            raise PepError(PepFault.STATE_UNREADABLE, "what would be remembered could not be made durable") from error

    def _label(self, found: Remembered) -> Label:
        """The label at writing, at most that of a record, as old as it is now."""
        written = Label(
            sources=frozenset(map(Source, found.sources)),
            signers=frozenset(found.signers),
            integrity=Integrity(admission.INTEGRITIES.index(found.integrity)),
            age_ms=found.age_ms,
            tainted=found.tainted,
        )
        record = Label(frozenset({Source.MEMORY}), frozenset({found.writer}), Integrity.RECORDED, 0)
        return aged(joined((written, record)), int(self._clock.wall_s() * 1_000) - found.at * 1_000)


def _digest(signed: str) -> str:
    return hashlib.sha256(signed.encode("utf-8", "surrogatepass")).hexdigest()


def _lost(name: str, fault: MemoryFault) -> Recalled:
    return Recalled(ItemReading(ItemKind.MEMORY, shown(name), NOBODY, fault=str(fault)), None)

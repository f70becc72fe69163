"""Memory with authority: the writer's token allows the write, and the row is believed as the writer's word.

A write needs the grant ("memory", "remember") at every hop of the writer's verified chain. It is one row, signed with
this enforcement point's key, that names the row before it ([STM-12] in docs/spec.md). The store is not trusted:
tampering shows when the memory is opened (`pep.context.memory_rows`) and at each read. A recalled value has at most the
integrity of a record, the taint that it was written with, and its age; it is content.

No row is deleted from a memory but with all of it: an overwritten one stays behind as evidence.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements.claims import TEXT_BYTES
from capabilities.statements.context import memory
from capabilities.statements.revocation import named
from capabilities.values import text
from capabilities.values.errors import CapabilityError, StatementError
from capabilities.values.scope import Tier
from pep.base.errors import PepError, PepFault
from pep.context import json_value as values
from pep.context.collection import shown
from pep.context.high_water_marks import HighWaterMark
from pep.context.json_value import Plain
from pep.context.label_words import label_in, words_of
from pep.context.memory_rows import ROWS, History, MemoryFault, MemoryRow, Owner, digest_of
from policies.evidence.content_readings import ItemKind, ItemReading
from policies.words.labels import NOBODY, Integrity, Label, Source, aged, joined

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.context.memory import Remembered
    from capabilities.token.verify import Verifier
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain, Refusal
    from capabilities.values.errors import Fault
    from pep.base.ports import Clock, RevocationFeed
    from pep.context.collection import Incident
    from pep.context.high_water_marks import HighWaterMarks
    from pep.context.memory_rows import MemoryRows

OBJECT: Final = "memory"
OPERATION: Final = "remember"
"""Grant that a write needs. It has no parameters: a token lends the memory or does not."""
VALUE_BYTES: Final = 16_384
"""Largest value in canonical JSON: notes and poses; a longer one is a document."""
ROWS_OF_A_WRITER: Final = 4_096
"""Most rows of one agent, so that one that writes without end fills its own part."""
MARK_NAME: Final = "memory"


@dataclass(frozen=True, slots=True)
class Written:
    """Receipt of a write. `digest` is the SHA-256 (hex) of the row's text, for the record."""

    sequence: int
    digest: str


@dataclass(frozen=True, slots=True)
class Recalled:
    """Recalled value with its reading for admission; the value is None when its provenance is not believed."""

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
        feed: the revocation feed.
        clock: wall time.
        caps: the bounds.

    Raises:
        PepError: `STATE_UNREADABLE` when store or mark cannot be read.
    """

    def __init__(
        self,
        rows: MemoryRows,
        *,
        marks: HighWaterMarks,
        key: PrivateKey,
        audience: str,
        verifier: Verifier,
        feed: RevocationFeed,
        clock: Clock,
        caps: Caps,
    ) -> None:
        self._rows = rows
        self._marks = marks
        self._owner = Owner(key, audience, caps)
        self._verifier = verifier
        self._feed = feed
        self._clock = clock
        self._failed = False
        self._lock = threading.Lock()
        try:
            held = list(rows.rows(most=ROWS + 1))
        except Exception as error:
            raise PepError(PepFault.STATE_UNREADABLE, "the memory cannot be read") from error
        self._history = History(held, self._owner, seen=marks.read(MARK_NAME))

    def remember(
        self, name: str, value: Plain, *, label: Label, chain: Chain
    ) -> Written | MemoryFault | Refusal | Fault:
        """Writes the value under the name, on disk; or returns the reason why nothing was written.

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
        # 1 the new row, before anything that costs
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
            writer, history = chain.leaf.agent, self._history
            if history.head.version >= ROWS or history.written.get(writer, 0) >= ROWS_OF_A_WRITER:
                return MemoryFault.FULL
            try:
                signed = memory.sign(self._row_of(name, value, label=label, chain=chain, at=at), self._owner.key)
            except StatementError:
                return MemoryFault.NOT_WRITABLE
            head = HighWaterMark(history.head.version + 1, digest_of(signed))
            row = MemoryRow(head.version, signed, value.raw)
            if isinstance(self._owner.authentic(row), MemoryFault):
                return MemoryFault.NOT_WRITABLE
            self._keep(row, head)
            history.adopt(name, writer, head)
            return Written(head.version, head.digest)

    def recall(self, name: str, *, lease_ms: int) -> Recalled:
        """Value last remembered under the name, verified anew; or the reason why it is not believed.

        Args:
            name: as it was written.
            lease_ms: oldest acceptable revocation view.
        """
        with self._lock:
            place, broken = self._history.places.get(name), self._history.broken
        if place is None:
            return _lost(name, MemoryFault.ROLLED_BACK if broken else MemoryFault.ABSENT)
        if place.version < broken:
            return _lost(name, MemoryFault.ROLLED_BACK)
        try:
            row = self._rows.row(place.version)
        except Exception:  # noqa: BLE001 - any error of a store means nothing was read
            return _lost(name, MemoryFault.STORE_FAILED)
        found = MemoryFault.ROW_MISSING if row is None else self._owner.authentic(row)
        if isinstance(found, MemoryFault) or row is None or digest_of(row.text) != place.digest:
            fault = found if isinstance(found, MemoryFault) else MemoryFault.ROW_FORGED
            with self._lock:
                self._history.note(place.version, fault)
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

    @property
    def incidents(self) -> tuple[Incident, ...]:
        """Faults of the store when it was opened, and those found since."""
        return self._history.incidents

    def _row_of(self, name: str, value: Plain, *, label: Label, chain: Chain, at: float) -> Remembered:
        return memory.Remembered(
            audience=self._owner.audience,
            sequence=self._history.head.version + 1,
            previous=self._history.head.digest or memory.FIRST_PREVIOUS,
            name=name,
            value=value.digest,
            writer=chain.leaf.agent,
            hop_id=chain.leaf.hop_id,
            token_id=chain.token_id,
            behind=tuple(sorted(named(chain))),
            **words_of(label),
            at=int(at),
        )

    def _keep(self, row: MemoryRow, head: HighWaterMark) -> None:
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
        record = Label(frozenset({Source.MEMORY}), frozenset({found.writer}), Integrity.RECORDED, 0)
        return aged(joined((label_in(found), record)), int(self._clock.wall_s() * 1_000) - found.at * 1_000)


def _lost(name: str, fault: MemoryFault) -> Recalled:
    return Recalled(ItemReading(ItemKind.MEMORY, shown(name), NOBODY, fault=str(fault)), None)

"""Curated retrieval: a content of a collection is believed for its digest in a curator's manifest, and no more.

The store is not trusted: a writer to it may change, swap, add, delete and roll back. So everything is verified after
retrieval, on the very bytes that would enter a context ([STM-7] in docs/spec.md, CII-3). The description of a scenario
is a content like any other, of a collection of scenarios. Contents that the store chooses not to return are not missed
here, but for entries that are gone altogether: the order of its findings is the store's word.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements import statement_form
from capabilities.statements.claims import TEXT_BYTES
from capabilities.statements.context import manifest
from capabilities.statements.revocation import Revoked
from capabilities.values import text
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from pep.context.collection import Incident, Retrieval, RetrievalFault, Retrieved, shown
from pep.context.high_water_marks import HighWaterMark
from policies.evidence.content_readings import ItemKind, ItemReading
from policies.words.labels import NOBODY, Integrity, Label, Source

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.context.manifest import Manifest, ManifestEntry
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock, RevocationFeed
    from pep.context.collection import Collection, Curators, StoredContent
    from pep.context.high_water_marks import HighWaterMarks

DOCUMENT_BYTES: Final = 65_536
"""Largest content in UTF-8: a chunk of a handbook has some kB, and an admitted one fills an agent's context."""
QUERY_BYTES: Final = 8_192
MOST: Final = 32
"""Most contents of one retrieval."""
SUPERSEDED_KEPT: Final = 4
"""Earlier manifests that are remembered, so that their contents can be told from unsigned ones."""
_KIND: Final = {"document": ItemKind.DOCUMENT, "scenario": ItemKind.SCENARIO}


@dataclass(frozen=True, slots=True)
class _Current:
    """The manifest in force, with the thumbprint of the key that signed it."""

    manifest: Manifest
    digest: str
    signer: str
    by_id: Mapping[str, ManifestEntry]
    digests: frozenset[str]


class Curated:
    """One curated collection. Any thread.

    Args:
        collection: in its store.
        name, content: of the collection, as its manifests must state them.
        curators: curators who may sign manifests.
        feed: revoked keys; a key of kind `key` with its thumbprint revokes a curator.
        marks: the newest manifest that was ever accepted, over restarts.
        clock: wall time for ages and ends.
        caps: bounds and skew.
    """

    def __init__(
        self,
        collection: Collection,
        *,
        name: str,
        content: str,
        curators: Curators,
        feed: RevocationFeed,
        marks: HighWaterMarks,
        clock: Clock,
        caps: Caps,
    ) -> None:
        self._collection = collection
        self._name = name
        self._content = content
        self._curators = curators
        self._feed = feed
        self._marks = marks
        self._clock = clock
        self._caps = caps
        self._lock = threading.Lock()
        self._current: _Current | None = None
        self._superseded: list[_Current] = []

    @property
    def mark_name(self) -> str:
        """Name under which the newest manifest is remembered."""
        return f"manifest/{self._content}/{self._name}"

    def adopt(self, signed: str) -> Manifest | Fault:
        """Puts the manifest in force; or returns the reason why it is refused, and the earlier one stays.

        Args:
            signed: text of the statement, from any source.

        Raises:
            PepError: `STATE_UNREADABLE` when what was seen is not known, or could not be made durable.
        """
        known = self._curators.curators()
        try:
            opened = manifest.open(signed, frozenset(known.values()), self._caps)
        except CapabilityError as error:
            return Fault(error.code, "STM-7", error.detail)
        signer = statement_form.signer_thumbprint(signed)
        curator = next(id_ for id_, raw in known.items() if keys.thumbprint(raw) == signer)
        digest = manifest.digest_of(signed)
        by_id = {entry.id: entry for entry in opened.entries}
        taken = _Current(opened, digest, signer, by_id, frozenset(entry.digest for entry in opened.entries))
        with self._lock:
            seen = self._marks.read(self.mark_name)
            place = manifest.ExpectedManifest(self._name, self._content, curator, seen.version, seen.digest)
            refused = manifest.refusal(opened, digest, place, at=self._clock.wall_s(), caps=self._caps)
            refused = refused or self._revoked(signer)
            if refused is not None:
                return refused
            # Seen before it is acted on: a power cut between the two must not leave room for the older one.
            if seen != HighWaterMark(opened.version, digest):
                self._marks.write(self.mark_name, HighWaterMark(opened.version, digest))
            if self._current is not None and self._current.digest != digest:
                self._superseded = [self._current, *self._superseded][:SUPERSEDED_KEPT]
            self._current = taken
        return opened

    def retrieve(self, query: str, *, most: int, lease_ms: int) -> Retrieval:
        """Nearest contents of the store to the query, each judged; and the faults of the collection.

        Args:
            query: at most `QUERY_BYTES` of UTF-8; it reaches the store and no decision.
            most: contents, at most `MOST`.
            lease_ms: oldest acceptable revocation view.
        """
        if not (0 < most <= MOST and len(query.encode("utf-8", "surrogatepass")) <= QUERY_BYTES):
            return Retrieval((), (Incident(RetrievalFault.QUERY_TOO_LARGE, ""),))
        try:
            found = list(self._collection.nearest(query, most=most))[:most]
        except Exception:  # noqa: BLE001 - any error of a store means nothing was retrieved
            return Retrieval((), (Incident(RetrievalFault.STORE_FAILED, ""),))
        with self._lock:
            current, superseded = self._current, tuple(self._superseded)
        fault = self._fault(current, lease_ms=lease_ms)
        heard: set[str] = set()
        items = []
        for one in found:
            items.append(self._judged(one, current, superseded, fault=fault, again=one.id in heard))
            heard.add(one.id)
        return Retrieval(tuple(items), self.audit(lease_ms=lease_ms))

    def audit(self, *, lease_ms: int) -> tuple[Incident, ...]:
        """Faults of the whole collection: listed ids that are gone, and ids that no curator listed, in order.

        Args:
            lease_ms: oldest acceptable revocation view.
        """
        current = self._current
        fault = self._fault(current, lease_ms=lease_ms)
        if current is None or fault:
            return (Incident(fault, ""),)
        try:
            # One more than can be listed shows that some are not; which ones a flood consists of is of no use.
            held = frozenset(self._collection.ids(most=2 * manifest.ENTRIES))
        except Exception:  # noqa: BLE001 - any error of a store
            return (Incident(RetrievalFault.STORE_FAILED, ""),)
        gone = [Incident(RetrievalFault.MISSING, id_) for id_ in sorted(current.by_id.keys() - held)]
        strange = [Incident(RetrievalFault.NOT_LISTED, shown(id_)) for id_ in sorted(held - current.by_id.keys())]
        return (*gone, *strange)

    def _fault(self, current: _Current | None, *, lease_ms: int) -> str:
        """Code of a fault of the whole collection now; "" when its contents are judged one by one."""
        if current is None:
            return RetrievalFault.NO_MANIFEST
        held = current.manifest
        raw = self._curators.curators().get(held.curator)
        if raw is None or keys.thumbprint(raw) != current.signer:
            return str(FaultCode.STATEMENT_UNTRUSTED)
        if self._feed.view().age_ms > lease_ms:
            return str(FaultCode.REVOCATION_VIEW_STALE)
        place = manifest.ExpectedManifest(self._name, self._content, held.curator, held.version, current.digest)
        refused = manifest.refusal(held, current.digest, place, at=self._clock.wall_s(), caps=self._caps)
        refused = refused or self._revoked(current.signer)
        return "" if refused is None else str(refused.code)

    def _revoked(self, signer: str) -> Fault | None:
        if (str(Revoked.KEY), signer) in self._feed.view().revoked:
            return Fault(FaultCode.STATEMENT_UNTRUSTED, "STM-7", "the curator's key is revoked")
        return None

    def _judged(
        self, one: StoredContent, current: _Current | None, superseded: tuple[_Current, ...], *, fault: str, again: bool
    ) -> Retrieved:
        """The numbered recipe of one content."""
        if current is None or fault:
            return self._refused(one, fault)
        # 1 an id of the one grammar, so that no other id looks like it; once
        try:
            text.name(one.id, most_bytes=TEXT_BYTES)
        except CapabilityError:
            return self._refused(one, RetrievalFault.ID_MALFORMED)
        if again:
            return self._refused(one, RetrievalFault.TWICE)
        # 2 a text, of a size that may enter a context
        if not isinstance(one.text, str) or len(one.text) > DOCUMENT_BYTES:
            large = isinstance(one.text, str)
            return self._refused(one, RetrievalFault.TOO_LARGE if large else RetrievalFault.NOT_TEXT)
        try:
            raw = one.text.encode("utf-8")
        except UnicodeEncodeError:
            return self._refused(one, RetrievalFault.NOT_TEXT)
        if len(raw) > DOCUMENT_BYTES:
            return self._refused(one, RetrievalFault.TOO_LARGE)
        # 3 listed under this id with exactly these bytes
        digest = hashlib.sha256(raw).hexdigest()
        entry = current.by_id.get(one.id)
        if entry is not None and entry.digest == digest:
            return Retrieved(self._reading(one.id, current, listed=True), one.text)
        # 4 else: signed once by a curator who is still believed, and taken back; or never signed
        for older in superseded:
            before = older.by_id.get(one.id)
            if before is not None and before.digest == digest and self._stands(older):
                return Retrieved(self._reading(one.id, older, listed=False), "")
        if digest in current.digests:
            return self._refused(one, RetrievalFault.SWAPPED)
        return self._refused(one, RetrievalFault.NOT_LISTED if entry is None else RetrievalFault.CHANGED)

    def _stands(self, older: _Current) -> bool:
        raw = self._curators.curators().get(older.manifest.curator)
        return raw is not None and keys.thumbprint(raw) == older.signer and self._revoked(older.signer) is None

    def _reading(self, id_: str, current: _Current, *, listed: bool) -> ItemReading:
        # A curator whose clock is ahead by less than the skew signed just now, not in the future.
        age_ms = max(0, int(self._clock.wall_s() * 1000) - current.manifest.at * 1000)
        label = Label(frozenset({Source.RETRIEVAL}), frozenset({current.manifest.curator}), Integrity.CURATED, age_ms)
        return ItemReading(_KIND[self._content], id_, label, listed=listed, manifest_age_s=age_ms // 1000)

    def _refused(self, one: StoredContent, fault: str) -> Retrieved:
        return Retrieved(ItemReading(_KIND[self._content], shown(one.id), NOBODY, fault=str(fault)), "")

"""Curated collection at an enforcement point: contents as a store returns them, and as they are judged."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from capabilities.statements.claims import TEXT_BYTES
from capabilities.values import text
from capabilities.values.errors import CapabilityError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from policies.evidence.content_readings import ItemReading


@dataclass(frozen=True, slots=True)
class StoredContent:
    """One content as the store returns it, unverified; a text that is None is missing."""

    id: str
    text: str | None


class Collection(Protocol):
    """Collection in a store. Either call may raise any error of the store."""

    def nearest(self, query: str, *, most: int) -> Sequence[StoredContent]:
        """At most `most` contents, the nearest to the query first."""
        ...

    def ids(self, *, most: int) -> Sequence[str]:
        """At most `most` ids that the collection holds."""
        ...


class Curators(Protocol):
    """Port for the curators that this enforcement point knows."""

    def curators(self) -> Mapping[str, bytes]:
        """Raw public key by curator's id; none of these keys has another role."""
        ...


class RetrievalFault(StrEnum):
    """Reasons not to believe a content, beside the manifest's own (`capabilities.values.errors.FaultCode`)."""

    NO_MANIFEST = "NO_MANIFEST"
    NOT_LISTED = "NOT_LISTED"
    """No curator ever listed it here.

    A content of an earlier manifest has no fault; it is only no longer listed.
    """
    ID_MALFORMED = "ID_MALFORMED"
    """An id that no manifest can have: look-alikes, turned and decomposed letters among them."""
    CHANGED = "CHANGED"
    SWAPPED = "SWAPPED"
    """The bytes of another entry."""
    TWICE = "TWICE"
    TOO_LARGE = "TOO_LARGE"
    NOT_TEXT = "NOT_TEXT"
    MISSING = "MISSING"
    """Listed, and no longer held."""
    STORE_FAILED = "STORE_FAILED"
    QUERY_TOO_LARGE = "QUERY_TOO_LARGE"


@dataclass(frozen=True, slots=True)
class Retrieved:
    """One judged content: its reading for admission, and its text, "" when its provenance is not believed."""

    reading: ItemReading
    text: str


@dataclass(frozen=True, slots=True)
class Incident:
    """Incident for an operator: a fault code, and the id it concerns ("" for the whole collection)."""

    fault: str
    id: str


@dataclass(frozen=True, slots=True)
class Retrieval:
    """Answer to one query: every content judged, and the faults of the collection."""

    items: tuple[Retrieved, ...]
    incidents: tuple[Incident, ...]


def shown(id_: object) -> str:
    """The id where it is a name; else an unmistakable name for it, for the record."""
    try:
        return text.name(id_, most_bytes=TEXT_BYTES)
    except CapabilityError:
        raw = str(id_).encode("utf-8", "surrogatepass")
        return f"unnamed:{hashlib.sha256(raw).hexdigest()[:16]}"

"""A curator's signed manifest of a collection: which contents, digest by digest, may be believed when they come out.

Clause [STM-7] in docs/spec.md.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Name, Positive, Whole, lasting, ordered, read
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.form import Form, plain, upto, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "manifest"
ENTRIES: Final = 768
"""Most entries of a manifest; with ids and sources of 63 bytes all of them together still fit a statement."""
CONTENTS: Final = frozenset({"document", "scenario"})
"""Kinds of content of a collection: documents that are read, or descriptions of scenarios.

One is never taken for the other.
"""
LIFETIME_S: Final = 366 * 86_400
"""Longest life of a manifest: a year, as of a cell file.

A policy bounds the age of those in use (`manifest_age_s`).
"""


class ManifestEntry(Form, frozen=True):
    """One listed content.

    Attributes:
        id: under which the collection holds it.
        digest: SHA-256 (hex) of its bytes.
        source: where the curator has it from.
    """

    id: Name
    digest: HexDigest
    source: Name


class Manifest(Form, frozen=True):
    """Manifest of a collection, with every entry that a curator vouches for.

    Attributes:
        collection: its name.
        content: kind of all its entries, one of `CONTENTS`.
        curator: id of who signs.
        version: grows with each change, from 1 on.
        entries: in the order of their ids, each id once. Two ids may have one digest.
        at, not_after: when it was signed, and until when it counts; seconds since the epoch.
    """

    collection: Name
    content: Annotated[str, words(*CONTENTS)]
    curator: Name
    version: Positive
    entries: Annotated[tuple[ManifestEntry, ...], upto(ENTRIES)]
    at: Whole
    not_after: Whole


@dataclass(frozen=True, slots=True)
class ExpectedManifest:
    """Place where a manifest is expected.

    Attributes:
        collection, content: those that the manifest must state.
        curator: the curator whose key opened it.
        version, digest: of the newest manifest that was ever accepted here; 0 and "" for none.
    """

    collection: str
    content: str
    curator: str
    version: int
    digest: str


def entry_of(id_: str, content: bytes, source: str) -> ManifestEntry:
    """The entry that lists these very bytes."""
    return ManifestEntry(id_, hashlib.sha256(content).hexdigest(), source)


def sign(manifest: Manifest, key: PrivateKey) -> str:
    """The manifest, signed by its curator."""
    return statement_form.seal(KIND, plain(manifest), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Manifest:  # noqa: A001 - read as manifest.open
    """The manifest, signed by one of these keys, with each id once and in order.

    Raises:
        StatementError: as `sealed.open`; also for one that ends before it begins or lives longer than `LIFETIME_S`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Manifest:
    manifest = read(Manifest, claims)
    ordered(tuple(entry.id for entry in manifest.entries), "an id")
    lasting(manifest.at, manifest.not_after, LIFETIME_S)
    return manifest


def refusal(manifest: Manifest, digest: str, place: ExpectedManifest, *, at: float, caps: Caps) -> Fault | None:
    """None when the manifest is the one to go by in its place, now; else the first fault ([STM-7]).

    To be asked at each use: a manifest that was accepted once ends, and a newer one may have been seen since.

    Args:
        manifest: opened with the key of the curator that `place` names.
        digest: SHA-256 (hex) of its text.
        place: where it is expected.
        at: seconds since the epoch.
        caps: the bounds.
    """
    if manifest.curator != place.curator:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "STM-7", "it names another curator than its key's")
    if (manifest.collection, manifest.content) != (place.collection, place.content):
        return Fault(FaultCode.WRONG_AUDIENCE, "STM-7", "the manifest of another collection")
    # Two manifests of one version are two truths: a party that chooses between them can take a correction back.
    if manifest.version < place.version or (manifest.version == place.version and digest != place.digest):
        return Fault(FaultCode.REPLAYED, "STM-7", f"version {place.version} was seen")
    if not manifest.at <= at + caps.skew_s:
        return Fault(FaultCode.NOT_YET_VALID, "STM-7")
    if not at < manifest.not_after:
        return Fault(FaultCode.EXPIRED, "STM-7")
    return None


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a manifest's text, which a verifier remembers beside its version."""
    return hashlib.sha256(text.encode("ascii")).hexdigest()

"""The ledger's chain, and the journals of enforcement points that it takes in.

Pure: entries and hashes, no file and no table.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import rfc8785

from ztpm_idp.domain import conduct
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import RecordTaken
from ztpm_idp.domain.parties import RegisteredPep, Standing
from ztpm_idp.domain.pictures import named_by

if TYPE_CHECKING:
    from ztpm_idp.domain.commands import TakeRecords
    from ztpm_idp.domain.events import PictureNamed
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

FIRST_PREV: Final = "0" * 64
"""`prev` of the first entry of a chain."""
VERSION: Final = 1
RECORD_KINDS: Final = frozenset(
    {
        "advice",
        "decision",
        "outcome",
        "picture",
        "refusal",
        "ask",
        "ask-answered",
        "ask-refused",
        "ask-expired",
        "incident",
        "latch-cleared",
        "latch-retreat",
        "latched",
        "lease",
        "lease-ended",
        "lease-renewed",
        "stop",
        "stream",
        "stream-values",
        "ticket",
    }
)
RECORD_FIELDS: Final = frozenset({"v", "pep", "seq", "prev", "at_ms", "kind", "body"})


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry, sealed.

    Attributes:
        seq: 1 and upwards.
        line: the entry's canonical JSON; its SHA-256 is the hash.
        digest: that hash, hex.
    """

    seq: int
    line: bytes
    digest: str


def seal(*, seq: int, prev: str, at_ms: int, actor: str, kind: str, body: dict[str, object]) -> Entry:
    """Entry that follows the one whose hash is `prev`."""
    entry = {"v": VERSION, "seq": seq, "prev": prev, "at_ms": at_ms, "actor": actor, "kind": kind, "body": body}
    line = rfc8785.dumps(entry)  # type: ignore[arg-type]
    return Entry(seq, line, hashlib.sha256(line).hexdigest())


def record_digest(record: dict[str, object]) -> str:
    """The hash of a PEP's record, hex."""
    return hashlib.sha256(rfc8785.dumps(record)).hexdigest()  # type: ignore[arg-type]


def take_records(rules: Rules, state: State, command: TakeRecords, at_ms: int) -> Outcome:
    """Takes the new records, in order; skips one that was taken before, and refuses one that differs.

    All or nothing: one refused record refuses the batch. Their reports on agents' conduct count with them.
    """
    pep = state.parties.get(command.by)
    if not isinstance(pep, RegisteredPep) or pep.standing is not Standing.ACTIVE:
        return Refusal(IdpCode.NOT_PERMITTED, "enforcement points ship records")
    journal = state.journal
    if journal is None:  # the store loads it whenever it is wanted
        raise AssertionError
    seq, head, taken = journal.seq, journal.head, list[RecordTaken]()
    pictures: list[PictureNamed] = []
    digests = dict(journal.digests)
    for record in command.records:
        if (wrong := _malformed(record)) is not None:
            return wrong
        if record["pep"] != command.by:
            return Refusal(IdpCode.RECORD_OF_ANOTHER, "a record names another enforcement point")
        digest, this = record_digest(record), int(str(record["seq"]))
        if this <= seq:
            if digests.get(this) != digest:
                return Refusal(IdpCode.RECORD_FORKED, f"record {this} differs from the one taken before")
            continue
        if this != seq + 1:
            return Refusal(IdpCode.RECORD_GAP, f"record {seq + 1} comes next")
        if record["prev"] != head:
            return Refusal(IdpCode.RECORD_CHAIN_BROKEN, f"record {this} does not follow the one before")
        taken.append(RecordTaken(command.by, this, digest, record))
        pictures += named_by(record)
        seq, head = this, digest
        digests[this] = digest
    return (*taken, *pictures, *conduct.reported(rules, state, pep, taken, at_ms))


def _malformed(record: dict[str, object]) -> Refusal | None:
    """Refusal of a record for its shape, or None.

    A record has seven fields, each of its exact type (neither true nor 1.0 is a 1).
    """
    if record.keys() != RECORD_FIELDS:
        return Refusal(IdpCode.BODY_MALFORMED, "a record has exactly v, pep, seq, prev, at_ms, kind and body")
    whole = all(type(record[name]) is int for name in ("v", "seq", "at_ms"))
    text = all(type(record[name]) is str for name in ("pep", "prev", "kind"))
    if not whole or not text or type(record["body"]) is not dict:
        return Refusal(IdpCode.BODY_MALFORMED, "a record's field is of the wrong type")
    if (
        record["v"] != VERSION
        or not int(str(record["seq"])) >= 1
        or not int(str(record["at_ms"])) >= 0
        or record["kind"] not in RECORD_KINDS
    ):
        return Refusal(IdpCode.BODY_MALFORMED, "a record's field is out of range")
    return None

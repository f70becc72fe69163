"""Verifying an exported ledger, or an enforcement point's journal, offline: pure, from lines and public keys.

Checked in this order for each entry: one canonical JSON form, the seven fields, the number, the link to the entry
before; for an enforcement point's record inside it, that record's own number and link. At the end the signed
checkpoint must name exactly this ledger. A journal is a chain of such records alone, and nobody signed its end: the
ledger that took it in holds that.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from capabilities.log import merkle
from capabilities.statements import checkpoint
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import StatementError
from capabilities.values.strict_json import JsonError, read_canonical
from ztpm_idp.domain.ledger import FIRST_PREV, RECORD_FIELDS, VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.keys.trust import TrustBundle
    from capabilities.log.tree_head import TreeHead

ENTRY_FIELDS: Final = frozenset({"v", "seq", "prev", "at_ms", "actor", "kind", "body"})
LINE_BYTES: Final = 1_048_576
"""Longest line: a record as large as a request body, and the entry around it."""
LINE_DEPTH: Final = 40
"""Deepest nesting: a record as deep as a request body, and the entry around it."""
_BEFORE: Final = b',"body":{"record":'
_BEHIND: Final = b'},"kind":"pep-record","prev":"'
"""Bytes around the record of an enforcement point in its canonical entry."""
_HASH: Final = re.compile(r"[0-9a-f]{64}")


class DefectCode(StrEnum):
    """Defect of a ledger."""

    LINE_MALFORMED = "LINE_MALFORMED"
    NOT_CANONICAL = "NOT_CANONICAL"
    ENTRY_MALFORMED = "ENTRY_MALFORMED"
    OUT_OF_SEQUENCE = "OUT_OF_SEQUENCE"
    CHAIN_BROKEN = "CHAIN_BROKEN"
    RECORD_MALFORMED = "RECORD_MALFORMED"
    RECORD_REPLAYED = "RECORD_REPLAYED"
    RECORD_GAP = "RECORD_GAP"
    RECORD_CHAIN_BROKEN = "RECORD_CHAIN_BROKEN"
    CHECKPOINT_MISSING = "CHECKPOINT_MISSING"
    CHECKPOINT_UNTRUSTED = "CHECKPOINT_UNTRUSTED"
    CHECKPOINT_OF_ANOTHER = "CHECKPOINT_OF_ANOTHER"
    CUT = "CUT"
    AFTER_CHECKPOINT = "AFTER_CHECKPOINT"
    LEDGER_FORKED = "LEDGER_FORKED"


@dataclass(frozen=True, slots=True)
class Verified:
    """The ledger is whole, from the entry that was asked for as the first.

    Attributes:
        size: number of the last entry.
        head: hash of the last, hex.
        as_of_ms: when its checkpoint was signed, or its last entry made.
    """

    size: int
    head: str
    as_of_ms: int


@dataclass(frozen=True, slots=True)
class VerifiedJournal:
    """The journal is unbroken up to its last record, whose own change only a ledger would show.

    Attributes:
        pep: the enforcement point that wrote it.
        size: number of records.
        head: hash of the last, hex.
        unfinished_bytes: of a record that was being written when its writer died; 0 when there is none.
    """

    pep: str
    size: int
    head: str
    unfinished_bytes: int


@dataclass(frozen=True, slots=True)
class Defect:
    """The first thing that is wrong.

    Attributes:
        seq: the entry that is wrong, as counted from 1; for a broken link the one whose hash is not what the next one
            says.
        code: the kind of defect.
    """

    seq: int
    code: DefectCode


class _Found(Exception):  # noqa: N818  it carries the defect out
    def __init__(self, seq: int, code: DefectCode) -> None:
        super().__init__(code)
        self.defect = Defect(seq, code)


def is_journal(line: bytes) -> bool:
    """True where this first line of a file is a record, and so the file a journal."""
    try:
        value, _ = read_canonical(line, limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH)
    except (JsonError, StatementError):
        return False
    return isinstance(value, dict) and value.keys() == RECORD_FIELDS


def verify_journal(lines: Iterable[bytes]) -> VerifiedJournal | Defect:
    """Result of checking that these lines are an enforcement point's unbroken journal.

    Args:
        lines: of the file, with their line ends; a last one without is a record that was never finished.
    """
    journals, unfinished, pep = _Journals(), 0, ""
    try:
        for seq, line in enumerate(lines, start=1):
            if not line.endswith(b"\n"):
                unfinished = len(line)
                break
            record = _value_of(line[:-1], seq)
            pep = pep or str(record.get("pep"))
            journals.take(pep, record, line[:-1], seq)
    except _Found as found:
        return found.defect
    size, head = journals.ends.get(pep, (0, FIRST_PREV))
    return VerifiedJournal(pep, size, head, unfinished)


def verify(
    lines: Iterable[bytes | str], trust: TrustBundle, *, first: int = 1, held: TreeHead | None = None
) -> Verified | Defect:
    """Result of checking that these lines are the whole, unchanged ledger that the identity provider signed.

    Args:
        lines: of the export, without line ends; the last one is the checkpoint.
        trust: names the issuer and the ledger's keys.
        first: number of the first entry that is wanted. Of what is before it nothing is said; each entry from it on
            is bound to the checkpoint.
        held: an earlier tree head of this ledger, with which a ledger that is whole must begin; where it does not,
            the defect is of the last entry that it covers.
    """
    walk = _Walk(trust, first, held)
    try:
        for line in lines:
            walk.take(line.encode() if isinstance(line, str) else line)
        return walk.end()
    except _Found as found:
        return found.defect


def _value_of(line: bytes, seq: int) -> dict[str, Any]:
    """Object of a canonical line."""
    try:
        value, canonical = read_canonical(line, limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH)
    except (JsonError, StatementError):
        raise _Found(seq, DefectCode.LINE_MALFORMED) from None
    if not canonical:
        raise _Found(seq, DefectCode.NOT_CANONICAL)
    if not isinstance(value, dict):
        raise _Found(seq, DefectCode.ENTRY_MALFORMED)
    return value


class _Journals:
    """Chains of enforcement points' records.

    Attributes:
        ends: number and hash of the last record of each enforcement point.
    """

    def __init__(self, *, whole: bool = True) -> None:
        """Each chain begins with its first record, unless they are not `whole`."""
        self.ends: dict[str, tuple[int, str]] = {}
        self._whole = whole

    def take(self, pep: str, record: object, spelled: bytes, seq: int) -> None:
        """One more record of that enforcement point, which is spelled so."""
        if not isinstance(record, dict) or record.keys() != RECORD_FIELDS:
            raise _Found(seq, DefectCode.RECORD_MALFORMED)
        number, prev = record["seq"], record["prev"]
        if type(number) is not int or type(prev) is not str or record["pep"] != pep or record["v"] != VERSION:
            raise _Found(seq, DefectCode.RECORD_MALFORMED)
        begins = (0, FIRST_PREV) if self._whole else (number - 1, prev)
        last, head = self.ends.get(pep, begins)
        if number <= last:
            raise _Found(seq, DefectCode.RECORD_REPLAYED)
        if number != last + 1:
            raise _Found(seq, DefectCode.RECORD_GAP)
        if prev != head:
            raise _Found(seq, DefectCode.RECORD_CHAIN_BROKEN)
        self.ends[pep] = number, hashlib.sha256(spelled).hexdigest()


class _Walk:
    """State of one verification."""

    def __init__(self, trust: TrustBundle, first: int, held: TreeHead | None) -> None:
        self._trust = trust
        self._held = held
        self._tree = merkle.GrowingTree()
        self._size = first - 1
        self._head: str | None = FIRST_PREV if first == 1 else None
        self._journals = _Journals(whole=first == 1)
        self._checkpoint: checkpoint.Checkpoint | None = None

    def take(self, line: bytes) -> None:
        """One more line."""
        seq = self._size + 1
        if self._checkpoint is not None:
            raise _Found(seq, DefectCode.AFTER_CHECKPOINT)
        value = _value_of(line, seq)
        if value.keys() == {"checkpoint"}:
            self._checkpoint = self._open(value["checkpoint"], seq)
        else:
            self._entry(value, seq, line)
            self._size, self._head = seq, hashlib.sha256(line).hexdigest()
            self._meet(line)

    def end(self) -> Verified:
        """Ends the walk after the last line."""
        signed = self._checkpoint
        if signed is None:
            raise _Found(self._size + 1, DefectCode.CHECKPOINT_MISSING)
        if signed.issuer != self._trust.issuer:
            raise _Found(self._size, DefectCode.CHECKPOINT_OF_ANOTHER)
        if signed.size != self._size:
            raise _Found(self._size, DefectCode.CUT)
        if self._head is None:
            raise _Found(self._size + 1, DefectCode.CUT)  # nothing of what was asked for is there
        if signed.head != self._head:
            raise _Found(self._size, DefectCode.CHAIN_BROKEN)
        if self._held is not None and self._size < self._held.size:
            raise _Found(self._size, DefectCode.CUT)
        return Verified(self._size, self._head, signed.as_of_ms)

    def _meet(self, line: bytes) -> None:
        """Compares the tree with the held one, once it has as many entries."""
        if self._held is None or self._size > self._held.size:
            return
        self._tree.append(merkle.leaf_hash(line))
        if self._size == self._held.size and self._tree.root() != self._held.root:
            raise _Found(self._size, DefectCode.LEDGER_FORKED)

    def _entry(self, value: dict[str, Any], seq: int, line: bytes) -> None:
        whole = value.keys() == ENTRY_FIELDS and all(type(value[name]) is int for name in ("v", "seq", "at_ms"))
        text = (
            whole
            and all(type(value[name]) is str for name in ("prev", "actor", "kind"))
            and type(value["body"]) is dict
        )
        if not text or value["v"] != VERSION or not _HASH.fullmatch(value["prev"]):
            raise _Found(seq, DefectCode.ENTRY_MALFORMED)
        if value["seq"] != seq:
            raise _Found(seq, DefectCode.OUT_OF_SEQUENCE)
        if self._head is not None and value["prev"] != self._head:
            raise _Found(max(1, seq - 1), DefectCode.CHAIN_BROKEN)
        if value["kind"] == "pep-record":
            self._record(value["actor"], value["body"], seq, line)

    def _record(self, actor: str, body: dict[str, Any], seq: int, line: bytes) -> None:
        if body.keys() != {"record"}:
            raise _Found(seq, DefectCode.RECORD_MALFORMED)
        # The line is canonical, and so is the part of it that is the record: no quote within a text stands unescaped.
        spelled = line[line.index(_BEFORE) + len(_BEFORE) : line.rindex(_BEHIND)]
        self._journals.take(actor, body["record"], spelled, seq)

    def _open(self, text: object, seq: int) -> checkpoint.Checkpoint:
        if not isinstance(text, str):
            raise _Found(seq, DefectCode.CHECKPOINT_UNTRUSTED)
        try:
            return checkpoint.open(text, self._trust.ledger, DEFAULT)
        except StatementError:
            raise _Found(seq, DefectCode.CHECKPOINT_UNTRUSTED) from None

"""Checkpoints of a log (C2SP tlog-checkpoint), and proofs that go with them (C2SP tlog-proof): [LOG-3]."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.log import merkle, note
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.units import INT_LIMIT

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey

PROOF_FORM: Final = "c2sp.org/tlog-proof@v1"
PROOF_BYTES: Final = 2_097_152
"""Longest file of a proof: an entry of a megabyte in base64, and the rest."""
_EXTRA: Final = "extra "
_NUMBER: Final = re.compile(r"0|[1-9][0-9]{0,15}")
_LINES: Final = 3


@dataclass(frozen=True, slots=True)
class TreeHead:
    """Size and root of a log's tree.

    Attributes:
        origin: the log's name; its key has the same.
        size: number of entries.
        root: SHA-256 root of the tree, 32 bytes.
    """

    origin: str
    size: int
    root: bytes

    @property
    def text(self) -> str:
        """The three lines that are signed."""
        return f"{self.origin}\n{self.size}\n{base64.b64encode(self.root).decode()}\n"


def origin_of(issuer: str) -> str:
    """Name of the ledger of an issuer: its URL without scheme, and `/ledger`."""
    return issuer.partition("://")[2] + "/ledger"


def sign(head: TreeHead, key: PrivateKey) -> str:
    """The checkpoint of this tree head, once it can be read.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for one that its own reader would refuse.
    """
    signed = note.sign(head.text, head.origin, key)
    _read(note.split(signed)[0])
    return signed


def open(text: str, origin: str, keys: Collection[bytes]) -> TreeHead:  # noqa: A001 - read as tree_head.open
    """The tree head of the checkpoint of this log, signed by one of these keys.

    Raises:
        StatementError: `STATEMENT_MALFORMED`; `STATEMENT_UNTRUSTED` also for the checkpoint of another log.
    """
    head = _read(note.open(text, [note.NoteKey(origin, key) for key in keys]))
    if head.origin != origin:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "the checkpoint of another log")
    return head


def _read(text: str) -> TreeHead:
    lines = text.split("\n")[:-1]
    if len(lines) < _LINES or not all(lines):
        raise _malformed("a checkpoint has three lines or more, none of them empty")
    origin, size, root = lines[:_LINES]
    if not _NUMBER.fullmatch(size) or int(size) > INT_LIMIT:
        raise _malformed("no size")
    raw = note.unbase64(root)
    if len(raw) != merkle.HASH_BYTES:
        raise _malformed("no root")
    return TreeHead(origin, int(size), raw)


@dataclass(frozen=True, slots=True)
class EntryProof:
    """Proof that an entry stands in a log, as a file that needs nothing else but the log's key.

    Attributes:
        index: of the entry, from 0: one less than its number.
        path: hashes from the leaf's sibling up.
        checkpoint: the signed note.
        entry: the entry itself, where the file holds it.
    """

    index: int
    path: tuple[bytes, ...]
    checkpoint: str
    entry: bytes | None = None

    @property
    def text(self) -> str:
        """The file's text."""
        extra = "" if self.entry is None else f"{_EXTRA}{base64.b64encode(self.entry).decode()}\n"
        path = "".join(f"{base64.b64encode(each).decode()}\n" for each in self.path)
        return f"{PROOF_FORM}\n{extra}index {self.index}\n{path}\n{self.checkpoint}"


def read_proof(text: str) -> EntryProof:
    """The proof in a file; nothing of it is verified yet.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    if len(text) > PROOF_BYTES:
        raise _malformed("too long for a proof")
    stated, blank, checkpoint = text.partition("\n\n")
    form, *lines = stated.split("\n")
    entry = None
    if lines and lines[0].startswith(_EXTRA):
        entry, lines = note.unbase64(lines[0].removeprefix(_EXTRA)), lines[1:]
    number = lines[0].removeprefix("index ") if lines else ""
    if not blank or form != PROOF_FORM or not lines[0].startswith("index ") or not _NUMBER.fullmatch(number):
        raise _malformed("not of the form " + PROOF_FORM)
    if len(lines) - 1 > merkle.LONGEST_PATH:
        raise _malformed("a path longer than any tree is high")
    return EntryProof(int(number), tuple(map(note.unbase64, lines[1:])), checkpoint, entry)


def check_entry(entry: bytes, proof: EntryProof, origin: str, keys: Collection[bytes]) -> TreeHead:
    """The tree head in which this proof finds the entry.

    Args:
        entry: the line, without its newline.
        proof: as read.
        origin: name of the log.
        keys: raw keys of the log.

    Raises:
        StatementError: as `open`; `STATEMENT_UNTRUSTED` where the path does not lead to the root.
    """
    head = open(proof.checkpoint, origin, keys)
    merkle.check_inclusion(merkle.leaf_hash(entry), proof.index, head.size, proof.path, head.root)
    return head


def _malformed(why: str) -> StatementError:
    return StatementError(FaultCode.STATEMENT_MALFORMED, why)

"""Signed notes: text with signature lines, as C2SP's signed-note defines them, by Ed25519 keys ([LOG-2])."""

from __future__ import annotations

import base64
import binascii
import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys, signatures
from capabilities.values.errors import BadKeyError, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey

NOTE_BYTES: Final = 65_536
"""Longest note: far above the 16 signature lines that every reader must take (C2SP signed-note)."""
SIGNATURES: Final = 64
"""Most signature lines that are looked at."""
ED25519: Final = b"\x01"
"""Type of an Ed25519 signature (C2SP signed-note)."""
_ID_BYTES: Final = 4
_DASH: Final = "\u2014 "


@dataclass(frozen=True, slots=True)
class NoteKey:
    """A key that may sign notes, under its name.

    Attributes:
        name: without spaces and plus signs.
        key: raw Ed25519 key.
    """

    name: str
    key: bytes

    @property
    def key_id(self) -> bytes:
        """The four bytes that name the key in a signature line."""
        return hashlib.sha256(self.name.encode() + b"\n" + ED25519 + self.key).digest()[:_ID_BYTES]

    @property
    def text(self) -> str:
        """The key as Go's `note` package and witnesses take it: `name+id+key`."""
        return f"{self.name}+{self.key_id.hex()}+{base64.b64encode(ED25519 + self.key).decode()}"


def sign(text: str, name: str, key: PrivateKey) -> str:
    """The note of this text, signed under this name.

    Args:
        text: ends with a newline; without other control characters.
        name: of the key.
        key: Ed25519.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another algorithm.
        StatementError: `STATEMENT_MALFORMED` for another text or name.
    """
    _check_text(text)
    _check_name(name)
    signer = NoteKey(name, keys.public_raw(key))
    if keys.algorithm_of(signer.key) is not keys.Algorithm.ED25519:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a note is signed by an Ed25519 key")
    signature = signatures.sign(key, text.encode())
    return f"{text}\n{_DASH}{name} {base64.b64encode(signer.key_id + signature).decode()}\n"


def open(note: str, known_keys: Collection[NoteKey]) -> str:  # noqa: A001 - read as note.open
    """The text of a note that one of these keys signed; lines of unknown keys count for nothing.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for no note, `STATEMENT_UNTRUSTED` where no known key signed it, or a
            signature of a known key is wrong.
    """
    text, lines = split(note)
    known = {(signer.name, signer.key_id): signer for signer in known_keys}
    trusted = False
    for name, raw in map(_signature, lines):
        signer = known.get((name, raw[:_ID_BYTES]))
        if signer is None:
            continue
        if not signatures.verify(signer.key, text.encode(), raw[_ID_BYTES:]):
            raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a signature of a known key is wrong")
        trusted = True
    if not trusted:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "signed by no known key")
    return text


def split(note: str) -> tuple[str, list[str]]:
    """Text and signature lines of a note, unverified.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    if len(note) > NOTE_BYTES or not note.endswith("\n"):
        raise _malformed("too long, or without its last newline")
    text, blank, signed = note[:-1].rpartition("\n\n")
    lines = signed.split("\n")
    if not blank or not 1 <= len(lines) <= SIGNATURES:
        raise _malformed("no signature lines behind an empty line")
    text += "\n"
    _check_text(text)
    return text, lines


def _signature(line: str) -> tuple[str, bytes]:
    name, _, encoded = line.removeprefix(_DASH).partition(" ")
    if not line.startswith(_DASH):
        raise _malformed("a signature line begins with a dash")
    _check_name(name)
    raw = unbase64(encoded)
    if len(raw) <= _ID_BYTES:
        raise _malformed("a signature of no bytes")
    return name, raw


def unbase64(text: str) -> bytes:
    """Bytes of standard base64 in its one spelling (RFC 4648 section 4).

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    try:
        raw = base64.b64decode(text.encode("ascii"), validate=True)
    except (binascii.Error, UnicodeEncodeError):
        raise _malformed("not base64") from None
    if base64.b64encode(raw).decode() != text:
        raise _malformed("a second spelling of base64")
    return raw


def _check_text(text: str) -> None:
    control = any(ord(each) < ord(" ") and each != "\n" for each in text)
    if not text.endswith("\n") or control or any("\ud800" <= each <= "\udfff" for each in text):
        raise _malformed("text with control characters, or without its newline")


def _check_name(name: str) -> None:
    if not name or "+" in name or any(each.isspace() for each in name):
        raise _malformed("a key's name is empty, or has a space or a plus sign")


def _malformed(why: str) -> StatementError:
    return StatementError(FaultCode.STATEMENT_MALFORMED, why)

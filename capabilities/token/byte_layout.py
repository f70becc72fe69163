"""Byte layout of tokens of this profile in their one encoding: read off the bytes, without a parser.

It is the exact way of `capabilities.token.wire` and of `capabilities.token.checks`. It knows the Protocol Buffers of a
token in one encoding alone: fields in the order of their numbers, each length and number in its shortest form, keys of
Ed25519. Any other encoding gets no answer here, never an error: the message is then read in full, and the full reader
says what is wrong, if anything is. Tests hold the two together: every answer given here is that of the full reader.
"""

from __future__ import annotations

from struct import Struct, error
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable

# Every token brings these values anew, and a frozen dataclass takes five times as long to make.


class SignedBlock(msgspec.Struct, frozen=True):
    """One block as it was signed.

    Attributes:
        third_party: it carries an external signature, in the version that binds it to its place.
        payload: the signed bytes.
    """

    third_party: bool
    payload: bytes


class Structure(msgspec.Struct, frozen=True):
    """Structure of a token: the root key id that it claims and its blocks, the authority block first."""

    root_key_id: int | None
    blocks: tuple[SignedBlock, ...]


class Contents(msgspec.Struct, frozen=True):
    """Content of a block's payload: one fact and checks, and nothing else.

    Attributes:
        symbols: its own texts, in order.
        predicate: of its one fact, as the number of a text.
        index: first term of the fact.
        raw: its other terms, byte strings that are not empty.
        checks: encoded, in order.
        version: of its Datalog.
    """

    symbols: tuple[str, ...]
    predicate: int
    index: int
    raw: tuple[bytes, ...]
    checks: tuple[bytes, ...]
    version: int


# Tags of fields, as capabilities.token.wire declares them: number * 8 + 2 for bytes, number * 8 for an integer.
_AUTHORITY, _BLOCK = 0x12, 0x1A
_PAYLOAD, _FACT, _CHECK, _PREDICATE, _TERM, _BYTES = 0x0A, 0x22, 0x32, 0x0A, 0x12, 0x2A
_QUERIES, _EXPRESSION, _OP, _VALUE, _INTEGER, _BINARY = 0x0A, 0x1A, 0x0A, 0x0A, 0x10, 0x1A
_QUERY: Final = 27
"""Number of the text `query`, which heads every check."""
_STARTS: Final = {5 + n: bytes((_OP, 3 + n, _VALUE, 1 + n, _INTEGER)) for n in range(1, 10)}
"""First bytes of an operation on an integer of 1 to 9 bytes, so not below zero; by its length."""
_KEY: Final = b"\x12\x24\x08\x00\x12\x20"
"""Starts field 2, a public key: algorithm 0, which is Ed25519, and 32 bytes."""
_AFTER_AUTHORITY: Final = Struct(">6s32x2s64x")
_AUTHORITY_SAYS: Final[tuple[bytes, ...]] = (_KEY, b"\x1a\x40")
"""Bytes after the payload of an authority block: the next key and the signature."""
_AFTER_HOP: Final = Struct(">6s32x2s64x4s64x6s32x2s")
_HOP_SAYS: Final[tuple[bytes, ...]] = (*_AUTHORITY_SAYS, b"\x22\x68\x0a\x40", _KEY, b"\x28\x01")
"""Bytes after the payload of a hop's block: besides, the external signature with its key, and signature version 1."""
_LAST: Final = Struct(">4s32x")
_LAST_SAYS: Final = (b"\x22\x22\x0a\x20",)
"""The proof with the next secret, which ends a token."""
_TERMS: Final = Struct(">B2s3sB4s16s4s32s4s32s4s32s")
_TERMS_SAY: Final = (0x08, b"\x12\x02\x10", b"\x12\x12\x2a\x10", *[b"\x12\x22\x2a\x20"] * 3)
"""First bytes of the terms of a fact: its name, the index, hop id, key, measurement and request digest."""


def structure(token: bytes) -> Structure | None:
    """Structure of a token whose every field outside the payloads has the one encoding; None for any other."""
    try:
        return _structure(token)
    except (IndexError, error):  # it ends before a field does
        return None


def _structure(token: bytes) -> Structure | None:
    root_key_id, at = (token[1], 2) if token[0] == 0x08 and token[1] < 0x80 else (None, 0)
    blocks: list[SignedBlock] = []
    tag, rest, says = _AUTHORITY, _AFTER_AUTHORITY, _AUTHORITY_SAYS
    while token[at] == tag:
        end, at = _span(token, at)
        middle, start = _span(token, at)
        if token[at] != _PAYLOAD or middle + rest.size != end or rest.unpack_from(token, middle) != says:
            return None
        blocks.append(SignedBlock(bool(blocks), token[start:middle]))
        at, tag, rest, says = end, _BLOCK, _AFTER_HOP, _HOP_SAYS
    if not blocks or at + _LAST.size != len(token) or _LAST.unpack_from(token, at) != _LAST_SAYS:
        return None
    return Structure(root_key_id, tuple(blocks))


def contents(payload: bytes, opened: Callable[[bytes], tuple[tuple[str, ...], int]], version: int) -> Contents | None:
    """Content of a block of this version, when it is one fact of the profile and checks; else None.

    Args:
        payload: of the block.
        opened: reader of the bytes before the fact; raises `ValueError` when they hold anything more.
        version: of Datalog.
    """
    try:
        return _contents(payload, opened, version)
    except (IndexError, ValueError, error):
        return None


def _contents(payload: bytes, opened: Callable[[bytes], tuple[tuple[str, ...], int]], version: int) -> Contents | None:
    # The version is the last field before the fact. Where these three bytes mean something else, `opened` finds out.
    at = payload.index(bytes((0x18, version, _FACT))) + 2
    symbols, stated = opened(payload[:at])
    end, fact = _span(payload, at)
    inner, start = _span(payload, fact)
    zero, name, one, index, two, hop_id, three, key, four, measurement, five, digest = _TERMS.unpack_from(
        payload, start
    )
    low, high = name
    at = start + _TERMS.size
    last, term = _span(payload, at)
    least, value = _span(payload, term)
    if not (
        stated == version
        and (payload[fact], zero, one, two, three, four, five) == (_PREDICATE, *_TERMS_SAY)
        and (payload[at], payload[term]) == (_TERM, _BYTES)
        and inner == last == least == end > value
        and low >= 0x80 > high > 0
        and index < 0x80
    ):
        return None
    raw = hop_id, key, measurement, digest, payload[value:end]
    checks: list[bytes] = []
    at = end
    while at < len(payload):
        if payload[at] != _CHECK:
            return None
        end, at = _span(payload, at)
        checks.append(payload[at:end])
        at = end
    if at != len(payload):
        return None
    return Contents(symbols, low & 0x7F | high << 7, index, raw, tuple(checks), version)


class Demands(msgspec.Struct, frozen=True):
    """Encoding of a check over the context, in a block with certain texts.

    Attributes:
        head: the query up to its first expression.
        ends: of each expression that may follow, in order, how it starts and how it ends.
    """

    head: bytes
    ends: tuple[tuple[bytes, bytes], ...]


def demands(predicate: int, variables: tuple[int, ...], stated: tuple[tuple[int, int], ...]) -> Demands:
    """The spelling of a check over one fact.

    Args:
        predicate: of the fact, as the number of a text.
        variables: its terms, likewise.
        stated: the comparisons with a constant that may follow, in order: variable and kind.
    """
    operands = {name: _number(name) for name in variables}
    terms = b"".join(_wrapped(_TERM, operands[name]) for name in variables)
    return Demands(
        _wrapped(0x0A, _number(_QUERY)) + _wrapped(0x12, _number(predicate) + terms),
        tuple(
            (_wrapped(_OP, _wrapped(_VALUE, operands[name])), _wrapped(_OP, _wrapped(_BINARY, bytes((0x08, kind)))))
            for name, kind in stated
        ),
    )


def context(encoded: bytes, spelling: Demands) -> list[int | None] | None:
    """Constants of a check in this spelling, each in its place, at least one; None for any other spelling."""
    try:
        end, at = _span(encoded, 0)
        if encoded[0] != _QUERIES or end != len(encoded) or not encoded.startswith(spelling.head, at):
            return None
        at += len(spelling.head)
        found: list[int | None] = []
        for first, last in spelling.ends:
            constant = None
            if at < end and encoded[at] == _EXPRESSION:
                stop, start = _span(encoded, at)
                if encoded.startswith(first, start) and encoded.endswith(last, start, stop):
                    constant, at = _constant(encoded[start + len(first) : stop - len(last)]), stop
            found.append(constant)
    except (IndexError, ValueError):
        return None
    return found if at == end and found.count(None) < len(found) else None


def _constant(op: bytes) -> int:
    """The integer, not below zero, of an operation that is one.

    Raises:
        ValueError: for any other.
    """
    if op[:5] != _STARTS.get(len(op)):
        raise ValueError("not an integer")
    value = op[-1]
    if value > 0x7F or (value == 0 and len(op) > 6):
        raise ValueError("a number that is cut off, or not in its shortest form")
    for byte in op[-2:4:-1]:
        if byte < 0x80:
            raise ValueError("more than one number")
        value = value << 7 | byte & 0x7F
    return value


def _wrapped(tag: int, value: bytes) -> bytes:
    return bytes((tag, len(value))) + value


def _number(value: int) -> bytes:
    """Field 1, an integer."""
    return b"\x08" + _varint(value)


def _varint(value: int) -> bytes:
    spelled = bytearray()
    while value > 0x7F:
        spelled.append(value & 0x7F | 0x80)
        value >>= 7
    spelled.append(value)
    return bytes(spelled)


def _span(raw: bytes, at: int) -> tuple[int, int]:
    """End of the field of bytes at `at`, and start of its value.

    Its length is in the shortest form.

    Raises:
        IndexError: when its length is cut off, or takes another form or more than two bytes.
    """
    length = raw[at + 1]
    if length < 0x80:
        return at + 2 + length, at + 2
    high = raw[at + 2]
    if not 0 < high < 0x80:
        raise IndexError
    return at + 3 + (length & 0x7F | high << 7), at + 3

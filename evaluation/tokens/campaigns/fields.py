"""Fields of Protocol Buffers as a tree, and changes that a parser may take for the same message.

Nothing here knows the schema: bytes that read as fields are taken for a message. So a change reaches the envelope, the
blocks, and the terms of a check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence
    from random import Random

VARINT, I64, LEN, I32 = 0, 1, 2, 5  # wire types (Protocol Buffers, "encoding")
_FIXED: Final = {I64: 8, I32: 4}
_DEEPEST: Final = 8
_DESCEND: Final = 0.7
"""Probability that a change goes to a field's own fields, where it has some."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field.

    Attributes:
        number, wire: of its tag.
        value: the bytes after the tag, and after the length where there is one.
        inner: the fields that `value` reads as, or none.
        raw: the whole, as it was written.
    """

    number: int
    wire: int
    value: bytes
    inner: tuple[Field, ...]
    raw: bytes


def varint(value: int, *, longer: int = 0) -> bytes:
    """The number in base 128, with so many bytes more than it needs."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    for _ in range(longer):
        out[-1] |= 0x80
        out.append(0)
    return bytes(out)


def write(number: int, wire: int, value: bytes, *, longer_tag: int = 0, longer_length: int = 0) -> bytes:
    """A field, with tag and length in as many bytes more as wanted."""
    length = varint(len(value), longer=longer_length) if wire == LEN else b""
    return varint(number << 3 | wire, longer=longer_tag) + length + value


def read(raw: bytes, *, deep: int = 0) -> tuple[Field, ...]:
    """The fields of a message that is written with the shortest numbers; none for anything else."""
    found: list[Field] = []
    at = 0
    while at < len(raw):
        start = at
        tag, at = _varint(raw, at)
        number, wire = tag >> 3, tag & 7
        if tag < 8 or number > 1_000:
            return ()
        if wire == VARINT:
            begin = at
            _, at = _varint(raw, at)
        elif wire in _FIXED:
            begin, at = at, at + _FIXED[wire]
        elif wire == LEN:
            length, begin = _varint(raw, at)
            at = begin + length
        else:
            return ()
        if at > len(raw) or begin > len(raw):
            return ()
        value = raw[begin:at]
        if write(number, wire, value) != raw[start:at]:
            return ()
        inner = read(value, deep=deep + 1) if wire == LEN and deep < _DEEPEST else ()
        found.append(Field(number, wire, value, inner, raw[start:at]))
    return tuple(found)


def _varint(raw: bytes, at: int) -> tuple[int, int]:
    """The number at this place and the place after it; beyond the end when it is cut."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(raw):
            break
        byte = raw[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte <= 0x7F:
            return value, at
    return 0, len(raw) + 1


def changed(fields: Sequence[Field], change: str, chance: Random) -> bytes:
    """The message with one change at a place that `chance` takes; every length around it fits again."""
    at = chance.randrange(len(fields))
    field = fields[at]
    parts = [each.raw for each in fields]
    if field.inner and chance.random() < _DESCEND:
        parts[at] = write(field.number, field.wire, changed(field.inner, change, chance))
        return b"".join(parts)
    match change:
        case "drop":
            del parts[at]
        case "double":
            parts.insert(chance.randrange(len(parts) + 1), field.raw)
        case "reorder":
            moved = parts.pop(at)
            parts.insert(chance.randrange(len(parts) + 1), moved)
        case "retag":
            parts[at] = _retagged(field, chance)
        case "lengthen":
            parts[at] = _lengthened(field, chance)
        case "split":
            parts[at] = _split(field, chance)
        case "add":
            parts.insert(chance.randrange(len(parts) + 1), _unknown(chance))
        case "empty":
            parts[at] = write(field.number, field.wire, b"" if field.wire == LEN else bytes(len(field.value)))
        case _:
            raise ValueError(change)
    return b"".join(parts)


CHANGES: Final = ("drop", "double", "reorder", "retag", "lengthen", "split", "add", "empty")


def _retagged(field: Field, chance: Random) -> bytes:
    """Field under another number, or as another wire type."""
    if chance.random() < 0.5:
        return write(chance.randrange(1, 17), field.wire, field.value)
    return varint(field.number << 3 | chance.choice((0, 1, 2, 3, 4, 5, 6, 7))) + field.raw[1:]


def _lengthened(field: Field, chance: Random) -> bytes:
    """Field with tag, length or number in more bytes than it needs."""
    longer = chance.choice((1, 1, 2, 4, 9))
    where = chance.randrange(3)
    if where == 0:
        return write(field.number, field.wire, field.value, longer_tag=longer)
    if field.wire == LEN:
        return write(field.number, field.wire, field.value, longer_length=longer)
    if field.wire == VARINT:
        number, _ = _varint(field.value, 0)
        if where == 1:  # the same number modulo 2^32 or 2^64, which a reader may cut off
            return write(field.number, field.wire, varint(number + (1 << chance.choice((32, 64)))))
        return write(field.number, field.wire, varint(number, longer=longer))
    return field.raw + b"\0"


def _split(field: Field, chance: Random) -> bytes:
    """A message in two halves, which Protocol Buffers put together again; another field twice, one of them void."""
    if len(field.inner) > 1:
        cut = chance.randrange(1, len(field.inner))
        halves = field.inner[:cut], field.inner[cut:]
        return b"".join(write(field.number, field.wire, b"".join(each.raw for each in half)) for half in halves)
    void = write(field.number, field.wire, b"" if field.wire == LEN else b"\0" * len(field.value))
    return field.raw + void if chance.random() < 0.5 else void + field.raw


def _unknown(chance: Random) -> bytes:
    """A field that the format does not have, or one that it has, with any contents."""
    wire = chance.choice((VARINT, I64, LEN, I32))
    value = {
        VARINT: varint(chance.getrandbits(chance.choice((1, 7, 31, 63)))),
        LEN: chance.randbytes(chance.randrange(9)),
    }
    return write(chance.randrange(1, 40), wire, value.get(wire, bytes(_FIXED.get(wire, 0))))

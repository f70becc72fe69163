"""Canonical text of any frozen value, and its digest: the same in every process, on every hash seed.

Total: every value has a text, so that a strange reading is recorded and denied and never stops the recorder.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

EXACT: Final = 2**53 - 1
"""Largest integer that every JSON reader keeps exactly (RFC 8259 section 6); larger ones are written as text."""

_ENCODER: Final = msgspec.json.Encoder(order="sorted")
_AS_IT_IS: Final = frozenset({str, bool, type(None)})
"""Types whose every value is plain."""


def plain(value: object) -> object:
    """`value` as JSON values: dataclasses with their type's name, bytes in hex, sets sorted, floats exact."""
    kind = type(value)
    if kind in _AS_IT_IS or (kind is int and -EXACT <= value <= EXACT):  # type: ignore[operator]
        return value  # the usual leaves, before all that is rarer
    return _writer(kind)(value)  # type: ignore[arg-type]  # mypy takes no type object for hashable


@cache
def _writer(kind: type) -> Callable[[Any], object]:
    """Writer for values of exactly this type; looked up once for each type, not for each value."""
    if is_dataclass(kind) and fields(kind):
        return _record(kind)
    for base, write in _WRITERS:
        if issubclass(kind, base):
            return write
    # never repr: an address would make two digests of one thing
    return lambda _: {"opaque": kind.__qualname__}


def _record(kind: type[Any]) -> Callable[[Any], object]:
    """Each field by its name, beside the type's."""
    title, names = kind.__name__, _names(kind)  # type: ignore[arg-type]  # as in `plain`

    def write(value: Any) -> object:
        written: dict[str, object] = {"type": title}
        for name in names:
            member = getattr(value, name)
            written[name] = member if type(member) in _AS_IT_IS else plain(member)
        return written

    return write


def record(value: object, given: Mapping[str, object]) -> dict[str, object]:
    """Plain form of a dataclass with these plain fields in place of its own."""
    written: dict[str, object] = {"type": type(value).__name__}
    for name in _names(type(value)):  # type: ignore[arg-type]  # as in `plain`
        written[name] = given[name] if name in given else plain(getattr(value, name))
    return written


@cache
def _names(kind: type[Any]) -> tuple[str, ...]:
    # a field that is no argument, such as a remembered hash, is no part of the value
    return tuple(field.name for field in fields(kind) if field.init)


def _map(value: dict[object, object]) -> object:
    return {"map": _in_order([[plain(key), plain(member)] for key, member in value.items()])}


def _set(value: frozenset[object]) -> object:
    return {"set": _in_order([plain(member) for member in value])}


def _in_order(members: list[Any]) -> list[Any]:
    """Plain values in the one order that their texts have; names among themselves need no text for that."""
    if len(members) < 2:
        return members
    return sorted(members, key=None if {*map(type, members)} == {str} else _encoded)


def _list(value: tuple[object, ...]) -> object:
    return [plain(member) for member in value]


_WRITERS: Final[tuple[tuple[type[Any], Callable[[Any], object]], ...]] = (
    (Enum, lambda member: plain(member._value_)),  # before the other types that an enum may be
    (int, lambda value: {"int": str(int(value))}),
    (str, str),
    (float, lambda value: {"float": value.hex()}),
    (bytes, lambda value: {"hex": value.hex()}),
    (bytearray, lambda value: {"hex": value.hex()}),
    (tuple, _list),
    (list, _list),
    (set, _set),
    (frozenset, _set),
    (dict, _map),
)


def _encoded(value: object) -> bytes:
    """JSON without choices, of a plain value."""
    try:
        return _ENCODER.encode(value)
    except UnicodeEncodeError:  # half a surrogate pair, which UTF-8 cannot write and an escape can
        return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode("ascii")


def text(value: object) -> str:
    """The canonical JSON text of `value`."""
    return _encoded(plain(value)).decode("utf-8")


def digest(kind: str, value: object) -> str:
    """SHA-256 (hex) over the kind and the canonical text of `value`."""
    return plain_digest(kind, plain(value))


def plain_digest(kind: str, value: object) -> str:
    """Digest of what has the plain form `value`."""
    return hashlib.sha256(b"ztpm/1 %s\n%s" % (kind.encode("utf-8"), _encoded(value))).hexdigest()

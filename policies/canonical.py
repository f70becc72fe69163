"""One canonical text for any frozen value, and its digest: the same in every process, on every hash seed.

Total: whatever is given has a text, so that a strange reading is recorded and denied and never stops the recorder.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable

EXACT: Final = 2**53 - 1
"""Largest integer that every JSON reader keeps exactly (RFC 8259 section 6); larger ones are written as text."""

_dumps: Final = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode
"""JSON without choices; escapes make it total over lone surrogates."""


def plain(value: object) -> object:
    """`value` as JSON values: dataclasses with their type's name, bytes in hex, sets sorted, floats exact."""
    kind = type(value)
    if kind is str or value is None or kind is bool or (kind is int and -EXACT <= value <= EXACT):  # type: ignore[operator]
        return value  # the usual leaves, before all that is rarer
    return _writer(kind)(value)


@cache
def _writer(kind: type) -> Callable[[Any], object]:
    """How values of exactly this type are written: asked once for each type, not for each value."""
    if is_dataclass(kind) and fields(kind):
        return _record(kind)
    for base, write in _WRITERS:
        if issubclass(kind, base):
            return write
    # never repr: an address would make two digests of one thing
    return lambda _: {"opaque": kind.__qualname__}


def _record(kind: type[Any]) -> Callable[[Any], object]:
    """Each field by its name, beside the type's."""
    title, names = kind.__name__, tuple(f.name for f in fields(kind))

    def write(value: Any) -> object:
        written: dict[str, object] = {"type": title}
        for name in names:
            written[name] = plain(getattr(value, name))
        return written

    return write


def _map(value: dict[object, object]) -> object:
    """Pairs in the order of their text, which for keys that are texts is the order of the keys."""
    if all(type(key) is str for key in value):
        return {"map": [[key, plain(value[key])] for key in sorted(value, key=_dumps)]}
    return {"map": sorted(([plain(key), plain(member)] for key, member in value.items()), key=_dumps)}


def _set(value: frozenset[object]) -> object:
    return {"set": sorted(map(plain, value), key=_dumps)}


def _list(value: tuple[object, ...]) -> object:
    return [plain(member) for member in value]


_WRITERS: Final[tuple[tuple[type[Any], Callable[[Any], object]], ...]] = (
    (Enum, lambda value: plain(value.value)),  # before what an enum may be besides
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


def text(value: object) -> str:
    """The canonical JSON text of `value`."""
    return _dumps(plain(value))


def digest(kind: str, value: object) -> str:
    """SHA-256 (hex) over the kind and the canonical text of `value`."""
    return hashlib.sha256(f"ztpm/1 {kind}\n{text(value)}".encode("ascii")).hexdigest()

"""One canonical text for any frozen value, and its digest: the same in every process, on every hash seed.

Total: whatever is given has a text, so that a strange reading is recorded and denied and never stops the recorder.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Final

EXACT: Final = 2**53 - 1
"""Largest integer that every JSON reader keeps exactly (RFC 8259 section 6); larger ones are written as text."""


def plain(value: object) -> object:
    """`value` as JSON values: dataclasses with their type's name, bytes in hex, sets sorted, floats exact."""
    kind = type(value)
    if kind is str or value is None or kind is bool or (kind is int and -EXACT <= value <= EXACT):  # type: ignore[operator]
        return value  # the usual leaves, before all that is rarer
    if names := _fields(kind):  # type: ignore[arg-type]  # mypy takes no type object for hashable
        return {"type": kind.__name__, **{name: plain(getattr(value, name)) for name in names}}
    match value:
        case Enum():
            return plain(value.value)
        case int():
            return {"int": str(int(value))}
        case str():
            return str(value)
        case float():
            return {"float": value.hex()}
        case bytes() | bytearray():
            return {"hex": bytes(value).hex()}
        case tuple() | list():
            return [plain(member) for member in value]
        case set() | frozenset():
            return {"set": sorted((plain(member) for member in value), key=_dumps)}
        case dict():
            return {"map": sorted(([plain(k), plain(v)] for k, v in value.items()), key=_dumps)}
        case _:
            # never repr: an address would make two digests of one thing
            return {"opaque": kind.__qualname__}


@cache
def _fields(kind: type) -> tuple[str, ...]:
    """The field names of a dataclass; nothing for any other type."""
    return tuple(f.name for f in fields(kind)) if is_dataclass(kind) else ()


def _dumps(value: object) -> str:
    """JSON without choices; escapes make it total over lone surrogates."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def text(value: object) -> str:
    """The canonical JSON text of `value`."""
    return _dumps(plain(value))


def digest(kind: str, value: object) -> str:
    """SHA-256 (hex) over the kind and the canonical text of `value`."""
    return hashlib.sha256(f"ztpm/1 {kind}\n{text(value)}".encode("ascii")).hexdigest()

"""JSON value with one spelling: to be admitted, digested, pointed into, and compared."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import rfc8785

from capabilities.values import strict_json
from capabilities.values.strict_json import JsonDefect, JsonError

VALUE_BYTES: Final = 1_048_576
"""Largest value in canonical JSON: 1 MiB, more than any model reads in one piece."""
VALUE_DEPTH: Final = 32
"""Deepest nesting of a value."""
POINTER_BYTES: Final = 256
"""Longest pointer."""
_INDEX: Final = re.compile(r"0|[1-9][0-9]{0,6}", re.ASCII)
_ESCAPE: Final = re.compile(r"~(?![01])")


class ValueFault(StrEnum):
    """Reason why an input is no value."""

    TOO_LARGE = "TOO_LARGE"
    MALFORMED = "MALFORMED"


@dataclass(frozen=True, slots=True)
class Plain:
    """A value, whole, finite and with one meaning.

    Attributes:
        value: made of texts, finite numbers, booleans, None, lists and dicts of its own.
        raw: its canonical JSON (RFC 8785), at most `VALUE_BYTES`. Text that has no canonical JSON has no value.
    """

    value: object
    raw: bytes

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the canonical JSON."""
        return hashlib.sha256(self.raw).hexdigest()


class _Nowhere:
    """Type of `NOWHERE`."""


NOWHERE: Final = _Nowhere()
"""Result of a pointer that points at nothing; no JSON value equals it."""


def plain(value: object) -> Plain | ValueFault:
    """The value as a copy of its own, which no caller can change behind its digest; never raises.

    A float that is a whole number comes back as that integer: they are one number in canonical JSON.
    """
    try:
        raw = rfc8785.dumps(value)  # type: ignore[arg-type]  # a value that is no JSON raises here
    except (rfc8785.CanonicalizationError, UnicodeEncodeError, RecursionError):
        return ValueFault.MALFORMED
    return _reread(raw)


def read(raw: bytes) -> Plain | ValueFault:
    """Value of one JSON text; canonical or not, it has exactly one meaning. Never raises."""
    try:
        value = strict_json.read(raw, limit_bytes=VALUE_BYTES, limit_depth=VALUE_DEPTH)
    except JsonError as error:
        return _fault(error)
    return plain(value)


def _reread(raw: bytes) -> Plain | ValueFault:
    try:
        return Plain(strict_json.read(raw, limit_bytes=VALUE_BYTES, limit_depth=VALUE_DEPTH), raw)
    except JsonError as error:
        return _fault(error)


def _fault(error: JsonError) -> ValueFault:
    return ValueFault.TOO_LARGE if error.defect is JsonDefect.TOO_LARGE else ValueFault.MALFORMED


def tokens(pointer: str) -> tuple[str, ...] | None:
    """Reference tokens of a JSON pointer (RFC 6901); None for a text that is no pointer."""
    if len(pointer) > POINTER_BYTES or (pointer and not pointer.startswith("/")) or _ESCAPE.search(pointer):
        return None
    return tuple(token.replace("~1", "/").replace("~0", "~") for token in pointer.split("/")[1:])


def found(value: object, pointer: str) -> object:
    """Value at the pointer, or `NOWHERE`."""
    steps = tokens(pointer)
    if steps is None:
        return NOWHERE
    for step in steps:
        match value:
            case dict() if step in value:
                value = value[step]
            case list() if _INDEX.fullmatch(step) and int(step) < len(value):
                value = value[int(step)]
            case _:
                return NOWHERE
    return value


def named(pointer: str) -> str:
    """Last name in a pointer; "" when there are only places in lists."""
    return next((token for token in reversed(tokens(pointer) or ()) if not _INDEX.fullmatch(token)), "")

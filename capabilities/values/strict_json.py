"""JSON with one meaning, the one strict reader of the project, and canonical bytes (RFC 8785).

Two readers must never see two different values in the same bytes, so bytes that one of them might read differently are
refused: duplicate keys, NaN and infinities, numbers that no double holds, integers beyond 2^53 - 1, other encodings,
halves of surrogate pairs; and, before the parser runs, more bytes or deeper nesting than is needed.
"""

from __future__ import annotations

import codecs
import json
import math
import re
from enum import StrEnum
from typing import Final, NoReturn

import msgspec
import rfc8785

from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.units import INT_LIMIT

DEPTH_LIMIT: Final = 16
"""Deepest nesting of arrays and objects in a statement; ours need seven."""
_DIGITS: Final = len(str(-INT_LIMIT))
"""Longest spelling of an integer: converting a very long run of digits is quadratic, so the length is asked first."""
_DIGITS_OF_MOST: Final = len(str(INT_LIMIT))
_STRING: Final = re.compile(rb'"(?:[^"\\]++|\\.)*+"?', re.DOTALL)
"""A text, or the beginning of one that does not end; possessive, so that no text is read twice."""
_NO_BRACKET: Final = bytes(set(range(256)) - set(b"[]{}"))
_NO_SIGN: Final = bytes(set(_NO_BRACKET) - set(b'"'))
_OPENING: Final = frozenset(b"[{")
_BEYOND: Final = bytes(range(0xF0, 0x100))
"""First bytes of characters beyond the basic plane: RFC 8785 orders names by halves of those."""
_FIGURES: Final = bytes.maketrans(b"123456789", b"0" * 9)
_LONG: Final = b"0" * _DIGITS_OF_MOST


class JsonDefect(StrEnum):
    """Defect of a JSON text."""

    TOO_LARGE = "TOO_LARGE"
    MALFORMED = "MALFORMED"
    NOT_FINITE = "NOT_FINITE"
    OUT_OF_RANGE = "OUT_OF_RANGE"


class JsonError(ValueError):
    """A text that is refused. `detail` names the kind of fault, never the value."""

    def __init__(self, defect: JsonDefect, detail: str) -> None:
        super().__init__(f"{defect}: {detail}")
        self.defect = defect
        self.detail = detail


def read(raw: bytes, *, limit_bytes: int, limit_depth: int) -> object:
    """The value of one JSON text that has exactly one meaning.

    Args:
        raw: as it came.
        limit_bytes: cap on the size, checked before parsing.
        limit_depth: cap on the nesting, checked before parsing.

    Raises:
        JsonError: `TOO_LARGE`; `NOT_FINITE` for NaN, infinities and numbers beyond a double; `OUT_OF_RANGE` for
            integers beyond 2^53 - 1; else `MALFORMED`.
    """
    if len(raw) > limit_bytes:
        raise JsonError(JsonDefect.TOO_LARGE, f"at most {limit_bytes} bytes")
    if raw.startswith(codecs.BOM_UTF8):
        raise JsonError(JsonDefect.MALFORMED, "begins with a byte order mark")
    _refuse_deep(raw, limit_depth)
    try:
        spelled = raw.decode("utf-8", errors="strict")
    except UnicodeDecodeError:
        raise JsonError(JsonDefect.MALFORMED, "not UTF-8") from None
    try:
        value = _DECODER.decode(spelled)
    except (json.JSONDecodeError, RecursionError):
        raise JsonError(JsonDefect.MALFORMED, "not JSON") from None
    if "\\u" in spelled:
        _refuse_surrogates(value)
    return value


def without_mark(raw: bytes) -> bytes:
    """The content of a file without a byte order mark, which some editors write (RFC 8259 section 8.1)."""
    return raw.removeprefix(codecs.BOM_UTF8)


def canonical(value: object) -> bytes:
    """The RFC 8785 bytes of a plain JSON value.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a value that has no such form.
    """
    if (found := _written_alike(value)) is not None:
        return found
    try:
        return rfc8785.dumps(value)  # type: ignore[arg-type]  # the except is for wrong types
    except (rfc8785.CanonicalizationError, UnicodeEncodeError, RecursionError):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "no canonical form") from None


def read_canonical(raw: bytes, *, limit_bytes: int, limit_depth: int) -> tuple[object, bool]:
    """The value of one JSON text, as of `read`, and whether the text is that value's RFC 8785 form.

    It says so many times faster than by reading strictly and writing that form: a text that a writer of one form gives
    back byte for byte repeats no key, and has nothing that only some readers take.

    Raises:
        JsonError: as `read`.
        StatementError: `STATEMENT_MALFORMED` for a value that has no such form.
    """
    if len(raw) <= limit_bytes and (found := _given_back(raw)):
        _refuse_deep(raw, limit_depth)
        return found[0], True
    value = read(raw, limit_bytes=limit_bytes, limit_depth=limit_depth)
    return value, canonical(value) == raw


def _written_alike(value: object) -> bytes | None:
    """The text that `_WRITER` writes, where it reads as this very value and RFC 8785 writes it alike; None else.

    It takes a twentieth of the time. What is no plain JSON (NaN, a set, a name that is no text) does not read back.
    """
    try:
        raw = _WRITER.encode(value)
    except (TypeError, ValueError, RecursionError):  # `rfc8785` says what is wrong
        return None
    if _may_differ(raw):
        return None
    try:
        return raw if _READER.decode(raw) == value else None
    except (ValueError, RecursionError):
        return None


def _given_back(raw: bytes) -> tuple[object] | None:
    """The value, where `_WRITER` gives back this text and writes it as RFC 8785 does; None where it may not."""
    if _may_differ(raw):
        return None
    try:
        value = _READER.decode(raw)
        return (value,) if _WRITER.encode(value) == raw else None
    except (ValueError, RecursionError):  # of msgspec too, and of bytes that are no text
        return None


def _may_differ(raw: bytes) -> bool:
    """True where RFC 8785 may order the names or write an integer otherwise."""
    if not raw.isascii() and len(raw.translate(None, _BEYOND)) != len(raw):
        return True
    figures = raw.translate(_FIGURES)  # an integer of so many digits may be beyond 2^53 - 1
    return figures.startswith(_LONG) or any(sign + _LONG in figures for sign in (b":", b",", b"[", b"-"))


def _plain_float(digits: str) -> float:
    """A float that all writers write alike: without exponent, with a fraction that is not zero.

    Raises:
        ValueError: it is another one.
    """
    value = float(digits)
    if repr(value) != digits or digits.endswith(".0"):
        raise ValueError(digits)
    return value


_READER: Final = msgspec.json.Decoder(float_hook=_plain_float)
_WRITER: Final = msgspec.json.Encoder(order="sorted")


def parse(raw: bytes) -> object:
    """The value of a statement's JSON: as `read`, and without floats, which have no place in a statement.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    try:
        value = read(raw, limit_bytes=len(raw), limit_depth=DEPTH_LIMIT)
    except JsonError as error:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, error.detail) from None
    if _has_float(value):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "a number that is no integer")
    return value


def parse_object(raw: bytes) -> dict[str, object]:
    """Parses an object, as `parse` does.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for anything else.
    """
    value = parse(raw)
    if not isinstance(value, dict):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not an object")
    return value


def _refuse_deep(raw: bytes, limit: int) -> None:
    """Bounds the nesting before the parser recurses; brackets inside strings do not count."""
    depth = 0
    if (
        b"\\" not in raw
    ):  # nothing is escaped: what is neither quote nor bracket counts for nothing, nor a text without one
        raw = raw.translate(None, _NO_SIGN).replace(b'""', b"")
    for sign in _STRING.sub(b"", raw).translate(None, _NO_BRACKET):
        depth += 1 if sign in _OPENING else -1
        if depth > limit:
            raise JsonError(JsonDefect.MALFORMED, f"nested deeper than {limit}")


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise JsonError(JsonDefect.MALFORMED, "a key occurs twice")
    return members


def _constant(_: str) -> NoReturn:
    raise JsonError(JsonDefect.NOT_FINITE, "NaN and Infinity are not JSON")


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        # 1e999 is valid JSON, and infinity to Python.
        raise JsonError(JsonDefect.NOT_FINITE, "beyond the range of a double")
    return value


def _whole(digits: str) -> int:
    if len(digits) > _DIGITS or not -INT_LIMIT <= (value := int(digits)) <= INT_LIMIT:
        raise JsonError(JsonDefect.OUT_OF_RANGE, "an integer beyond 2^53 - 1")
    return value


_DECODER: Final = json.JSONDecoder(
    object_pairs_hook=_unique, parse_constant=_constant, parse_float=_finite, parse_int=_whole
)


def _refuse_surrogates(value: object) -> None:
    """Escapes can spell half a character, which no UTF-8 text has and no other reader agrees on."""
    match value:
        case str():
            if any("\ud800" <= c <= "\udfff" for c in value):
                raise JsonError(JsonDefect.MALFORMED, "half a surrogate pair")
        case dict():
            for key, inner in value.items():
                _refuse_surrogates(key)
                _refuse_surrogates(inner)
        case list():
            for inner in value:
                _refuse_surrogates(inner)
        case _:
            pass


def _has_float(value: object) -> bool:
    match value:
        case float():
            return True
        case dict():
            return any(map(_has_float, value.values()))
        case list():
            return any(map(_has_float, value))
        case _:
            return False

"""Strict reading: bytes of bounded size, canonical JSON without floats, members of declared type and range.

A number that must be exact is a hexadecimal float in its one spelling (`float.hex`), so that no reader rounds it.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.verdict import Code, Refusal, need

if TYPE_CHECKING:
    from collections.abc import Collection

BYTES_MOST: Final = 8 * 2**20  # the largest scene with the most rows stays below 4 MiB
INTEGER_MOST: Final = 2**53 - 1  # RFC 8785: beyond it JSON numbers are not exact
NUMBER_MOST: Final = 1e6  # no length, time, mass or rate of a cell is larger in SI units


def canonical(value: Any) -> bytes:
    """Canonical spelling of a JSON value without floats (RFC 8785; all keys of a document are ASCII).

    Raises:
        UnicodeEncodeError: a text with half a surrogate pair.
    """
    return json.dumps(value, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def sha256(text: bytes) -> str:
    """Digest (hex)."""
    return hashlib.sha256(text).hexdigest()


def parsed(text: bytes | str, place: str, *, floats: bool) -> Any:
    """Value of a JSON text; keys never repeat.

    Raises:
        Refusal: not JSON, or a key repeats, or a float where there may be none.
    """

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        members = dict(pairs)
        need(len(members) == len(pairs), Code.KEY_REPEATS, place)
        return members

    def refused(_: str) -> Any:
        raise Refusal(Code.NOT_JSON, f"{place}: a number that is none here")

    def real(spelt: str) -> float:
        number = float(spelt)
        need(math.isfinite(number), Code.NOT_JSON, f"{place}: a number that is none here")
        return number

    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8")
        return json.loads(text, object_pairs_hook=once, parse_constant=refused, parse_float=real if floats else refused)
    except (ValueError, RecursionError) as error:
        raise Refusal(Code.NOT_JSON, place) from error


def table(value: Any, place: str, names: Collection[str], *, may: Collection[str] = ()) -> dict[str, Any]:
    """An object with exactly these members, and perhaps some that it `may` have."""
    need(type(value) is dict and {*names} <= value.keys() <= {*names, *may}, Code.MEMBER_WRONG, place)
    return dict(value)


def listed(value: Any, place: str, *, least: int, most: int) -> list[Any]:
    """A list of so many items."""
    need(type(value) is list, Code.MEMBER_WRONG, place)
    need(len(value) <= most, Code.TOO_LARGE, place)
    need(len(value) >= least, Code.MEMBER_WRONG, place)
    return list(value)


def word(value: Any, place: str, *, among: Collection[str] | None = None) -> str:
    """A text, one of these where they are given."""
    need(type(value) is str and (among is None or value in among), Code.MEMBER_WRONG, place)
    return str(value)


def whole(value: Any, place: str, *, low: int, high: int) -> int:
    """An integer in this range."""
    need(type(value) is int and low <= value <= high, Code.MEMBER_WRONG, place)
    return int(value)


def truth(value: Any, place: str) -> bool:
    """True or false."""
    need(type(value) is bool, Code.MEMBER_WRONG, place)
    return bool(value)


def exact(value: Any, place: str, *, low: float = -NUMBER_MOST, high: float = NUMBER_MOST) -> float:
    """A number in its exact spelling, or a whole one, in this range."""
    number = math.nan
    if type(value) is int and abs(value) <= INTEGER_MOST:
        number = float(value)
    elif type(value) is str:
        try:
            number = float.fromhex(value)
        except (ValueError, OverflowError) as error:
            raise Refusal(Code.MEMBER_WRONG, place) from error
        need(number.hex() == value, Code.MEMBER_WRONG, place)
    need(low <= number <= high, Code.MEMBER_WRONG, place)
    return number


def decimal(value: Any, place: str, *, low: float = -NUMBER_MOST, high: float = NUMBER_MOST) -> float:
    """A JSON number in this range, as the robot's file spells them."""
    need(type(value) in (int, float) and low <= value <= high, Code.MEMBER_WRONG, place)
    return float(value)


def vector(value: Any, place: str, number: Any = exact) -> tuple[float, float, float]:
    """Three numbers."""
    x, y, z = (number(item, place) for item in listed(value, place, least=3, most=3))
    return (x, y, z)

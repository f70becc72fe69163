"""Reading claims one by one: exactly the expected members, each of its type and inside its bounds ([STM-5])."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.keys import keys
from capabilities.values import text
from capabilities.values.errors import CapabilityError, FaultCode, StatementError
from capabilities.values.units import INT_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
_HEX_DIGEST: Final = re.compile(r"[0-9a-f]{64}", re.ASCII)
TEXT_BYTES: Final = 256
"""UTF-8 bytes of any name in a statement (as `Caps.text_bytes`)."""


class Claims:
    """The members of one object. Every read names the member, and `Claims` refuses an object with other members."""

    __slots__ = ("_members",)

    def __init__(self, value: object, *names: str) -> None:
        if not isinstance(value, dict) or value.keys() != set(names):
            raise malformed(f"not exactly {', '.join(names)}")
        self._members: dict[str, object] = value

    def integer(self, name: str, *, low: int = 0, high: int = INT_LIMIT) -> int:
        """An integer inside the bounds."""
        value = self._members[name]
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise malformed(f"{name} is no integer in {low}..{high}")
        return value

    def boolean(self, name: str) -> bool:
        """True or false."""
        value = self._members[name]
        if not isinstance(value, bool):
            raise malformed(f"{name} is not true or false")
        return value

    def name(self, name: str) -> str:
        """An identifier (capabilities.values.text)."""
        return self._grammar(name, lambda value: text.name(value, most_bytes=TEXT_BYTES))

    def name_or_empty(self, name: str) -> str:
        """An identifier, or nothing."""
        return "" if self._members[name] == "" else self.name(name)

    def url(self, name: str) -> str:
        """A canonical URL."""
        return self._grammar(name, lambda value: text.url(value, most_bytes=TEXT_BYTES))

    def hex_digest(self, name: str) -> str:
        """A SHA-256 as 64 lower-case hex digits."""
        value = self._members[name]
        if not isinstance(value, str) or _HEX_DIGEST.fullmatch(value) is None:
            raise malformed(f"{name} is no SHA-256 in hex")
        return value

    def digest(self, name: str) -> bytes:
        """The 32 bytes of `hex_digest`."""
        return bytes.fromhex(self.hex_digest(name))

    def public_key(self, name: str) -> bytes:
        """A usable raw public key, in base64url."""
        return self._grammar(name, lambda value: keys.check_raw(keys.unb64u(str(value))))

    def token(self, name: str, pattern: re.Pattern[str]) -> str:
        """A text that the pattern matches whole."""
        value = self._members[name]
        if not isinstance(value, str) or pattern.fullmatch(value) is None:
            raise malformed(f"{name} has a wrong form")
        return value

    def one_of(self, name: str, allowed: frozenset[str]) -> str:
        """One of a closed set of words."""
        value = self._members[name]
        if not isinstance(value, str) or value not in allowed:
            raise malformed(f"{name} is an unknown word")
        return value

    def each(self, name: str, read: Callable[[object], _T], *, most: int) -> tuple[_T, ...]:
        """A list of at most `most` members, each read by `read`."""
        value = self._members[name]
        if not isinstance(value, list) or len(value) > most:
            raise malformed(f"{name} is no list of at most {most}")
        return tuple(map(read, value))

    def raw(self, name: str) -> object:
        """The member as it is, for a reader of its own."""
        return self._members[name]

    def _grammar(self, name: str, read: Callable[[object], _T]) -> _T:
        try:
            return read(self._members[name])
        except CapabilityError:
            raise malformed(f"{name} has a wrong form") from None


def malformed(detail: str) -> StatementError:
    """The error for claims of a wrong form."""
    return StatementError(FaultCode.STATEMENT_MALFORMED, detail)


def ordered(found: tuple[_T, ...], what: str) -> tuple[_T, ...]:
    """The members, when each is there once and in order: one set has one spelling."""
    if found != tuple(sorted(set(found))):  # type: ignore[type-var]  # texts, or tuples of texts
        raise malformed(f"{what} twice, or out of order")
    return found


def unique(found: tuple[_T, ...], key: Callable[[_T], object], what: str) -> tuple[_T, ...]:
    """The members, when no two have the same key."""
    if len({key(member) for member in found}) != len(found):
        raise malformed(f"{what} twice")
    return found

"""The forms of claims: exactly the expected members, each of its type and inside its bounds ([STM-5])."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

from capabilities.keys import keys
from capabilities.values import form, strict_json, text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.form import converted, upto, whole, within
from capabilities.values.units import INT_LIMIT

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
TEXT_BYTES: Final = 256
"""UTF-8 bytes of any name in a statement (as `Caps.text_bytes`)."""
BODY_BYTES: Final = 65_536
"""Longest body of an intent or message in canonical JSON.

In base64 and with the other members it stays below the size of a statement (256 KiB).
"""
ID: Final = re.compile(r"[0-9a-f]{32}", re.ASCII)
"""An id or nonce: 16 random bytes in hex."""
NONCE: Final = re.compile(r"[A-Za-z0-9_-]{16,64}", re.ASCII)
"""A nonce of the identity provider or of one who asks it: 16 to 64 base64url characters."""

Whole = Annotated[int, within(0, INT_LIMIT)]
Positive = Annotated[int, within(1, INT_LIMIT)]
Signed = Annotated[int, within(-INT_LIMIT, INT_LIMIT)]
Name = Annotated[str, whole(text.NAME.pattern), upto(TEXT_BYTES)]
"""An identifier (capabilities.values.text)."""
NameOrEmpty = Annotated[str, whole(f"({text.NAME.pattern})?"), upto(TEXT_BYTES)]
AgentId = Annotated[str, whole(rf"(?!{text.ROLE_PREFIX}){text.NAME.pattern}"), upto(TEXT_BYTES)]
"""The id of an agent, which is not taken for a role."""
Id = Annotated[str, whole(ID.pattern)]
IdOrEmpty = Annotated[str, whole(f"({ID.pattern})?")]
Nonce = Annotated[str, whole(NONCE.pattern)]
TokenId = Annotated[str, whole(text.TOKEN_ID.pattern)]
Thumbprint = Annotated[str, whole(text.THUMBPRINT.pattern)]
HexDigest = Annotated[str, whole(r"[0-9a-f]{64}")]
"""A SHA-256 as 64 lower-case hex digits."""
HexDigestOrEmpty = Annotated[str, whole(r"([0-9a-f]{64})?")]


def _canonical(value: object) -> bytes:
    """The object in canonical JSON of at most `BODY_BYTES`."""
    body = strict_json.canonical(form.read(dict[str, Any], value))
    if len(body) > BODY_BYTES:
        raise malformed(f"a body over {BODY_BYTES} bytes")
    return body


if TYPE_CHECKING:
    Body = bytes
    Sentence = str
    Url = str
    PublicKey = bytes
    Sha256 = bytes
else:
    Body = converted(bytes, _canonical)
    Sentence = converted(str, lambda value: text.prose(value, most_bytes=DEFAULT.purpose_bytes))
    Url = converted(str, lambda value: text.url(value, most_bytes=TEXT_BYTES))
    PublicKey = converted(bytes, lambda value: keys.check_raw(keys.unb64u(form.read(str, value))))
    Sha256 = converted(bytes, lambda value: bytes.fromhex(form.read(HexDigest, value)))


def read(kind: type[_T], value: object) -> _T:
    """The claims as a `kind`.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, naming the first place that is wrong.
    """
    try:
        made: _T = form.read(kind, value)
    except form.FormError as error:
        raise malformed(str(error)) from None
    return made


def malformed(detail: str) -> StatementError:
    """The error for claims of a wrong form."""
    return StatementError(FaultCode.STATEMENT_MALFORMED, detail)


def lasting(at: int, not_after: int, most_s: int) -> None:
    """Checks that a statement of `at` counts for 1 to `most_s` seconds.

    Raises:
        StatementError: `STATEMENT_MALFORMED` otherwise.
    """
    if not 0 < not_after - at <= most_s:
        raise malformed(f"it counts for 1 to {most_s} s")


def ordered(found: tuple[Any, ...], what: str) -> None:
    """Checks that each member is there once and in order: one set has one spelling.

    Raises:
        StatementError: `STATEMENT_MALFORMED` otherwise.
    """
    if found != tuple(sorted(set(found))):
        raise malformed(f"{what} twice, or out of order")


def unique(found: tuple[_T, ...], key: Callable[[_T], object], what: str) -> None:
    """Checks that no two members have the same key.

    Raises:
        StatementError: `STATEMENT_MALFORMED` otherwise.
    """
    if len({key(member) for member in found}) != len(found):
        raise malformed(f"{what} twice")


def stated(body: bytes) -> dict[str, object]:
    """The object that the claims state for this body.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when it is no canonical JSON object.
    """
    found = strict_json.parse_object(body)
    if strict_json.canonical(found) != body:
        raise malformed("a body that is not canonical")
    return found

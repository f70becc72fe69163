"""The body of an intent or a message: one JSON object, of a form that the statement names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.claims import malformed
from capabilities.values import strict_json

if TYPE_CHECKING:
    from capabilities.statements.claims import Claims

BODY_BYTES: Final = 65_536
"""Longest body in canonical JSON: in base64 and with the rest it stays below the size of a statement (256 KiB)."""


def stated(body: bytes) -> dict[str, object]:
    """The object that the claims state for this body.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when it is no canonical JSON object.
    """
    found = strict_json.parse_object(body)
    if strict_json.canonical(found) != body:
        raise malformed("a body that is not canonical")
    return found


def body_of(claims: Claims) -> bytes:
    """The member `body`, an object, in canonical JSON of at most `BODY_BYTES`."""
    stated_body = claims.raw("body")
    if not isinstance(stated_body, dict):
        raise malformed("body is no object")
    body = strict_json.canonical(stated_body)
    if len(body) > BODY_BYTES:
        raise malformed(f"a body over {BODY_BYTES} bytes")
    return body

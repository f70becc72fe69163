"""The body of an intent or a message: one JSON object, of a form that the statement names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.claims import malformed
from capabilities.values import form, strict_json

BODY_BYTES: Final = 65_536
"""Longest body of an intent or message in canonical JSON.

In base64 and with the other members it stays below the size of a statement (256 KiB).
"""


def stated(body: bytes) -> dict[str, object]:
    """The object that the claims state for this body.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when it is no canonical JSON object.
    """
    found = strict_json.parse_object(body)
    if strict_json.canonical(found) != body:
        raise malformed("a body that is not canonical")
    return found


def _canonical(value: object) -> bytes:
    """The object in canonical JSON of at most `BODY_BYTES`."""
    body = strict_json.canonical(form.read(dict[str, Any], value))
    if len(body) > BODY_BYTES:
        raise malformed(f"a body over {BODY_BYTES} bytes")
    return body


if TYPE_CHECKING:
    Body = bytes
else:
    Body = form.converted(bytes, _canonical)

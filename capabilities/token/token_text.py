"""A token as text, for headers and command lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.keys import keys
from capabilities.values.errors import BadKeyError, Fault, FaultCode

if TYPE_CHECKING:
    from capabilities.values.caps import Caps

_CLAUSE = "TOK-1"


def token_to_text(token: bytes) -> str:
    """The token in base64url without padding."""
    return keys.b64u(token)


def token_from_text(value: str, caps: Caps) -> bytes | Fault:
    """The bytes of a token's text in its one spelling; or `TOKEN_MISSING`, `TOKEN_TOO_LARGE`, `TOKEN_MALFORMED`."""
    if not value:
        return Fault(FaultCode.TOKEN_MISSING, _CLAUSE)
    if len(value) > 4 * ((caps.token_bytes + 2) // 3):
        return Fault(FaultCode.TOKEN_TOO_LARGE, _CLAUSE)
    try:
        return keys.unb64u(value)
    except BadKeyError:
        return Fault(FaultCode.TOKEN_MALFORMED, _CLAUSE, "not canonical base64url")

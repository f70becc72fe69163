"""One form for every signed statement: a compact JWS over RFC 8785 bytes.

Its type names the kind of statement, and `kid` the key.

Clauses [STM-1] to [STM-5] in docs/spec.md. A statement has one spelling: the same claims and key give the same text,
and any other text is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys import jws, keys
from capabilities.values import strict_json
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

_HEADER: Final = frozenset({"alg", "kid", "typ"})


def type_of(kind: str) -> str:
    """The JWS type of a kind of statement."""
    return f"ztpm-{kind}+jwt"


def seal(
    kind: str,
    claims: dict[str, object],
    key: PrivateKey,
    reader: Callable[[dict[str, object]], object],
    *,
    most_bytes: int = DEFAULT.statement_bytes,
) -> str:
    """The statement of these claims, signed once its own reader has taken them ([STM-13]).

    Args:
        kind: the kind.
        claims: the claims.
        key: the key that signs.
        reader: what `open` of the kind calls with the claims, once the signature holds.
        most_bytes: longest text that `open` takes.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a statement that its reader would refuse, so that none is ever sent.
    """
    reader(strict_json.parse_object(strict_json.canonical(claims)))
    text = sign(kind, claims, key)
    if len(text) > most_bytes:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"over {most_bytes} bytes")
    return text


def sign(kind: str, claims: dict[str, object], key: PrivateKey) -> str:
    """Statement of these claims, signed unread: for a foreign kind or a test. Kinds of ours are sealed.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when the claims hold anything but texts, 53-bit integers, booleans, None,
            lists and objects.
    """
    payload = strict_json.canonical(claims)
    strict_json.parse_object(payload)  # a float has a canonical form, and no place in a statement
    return jws.sign({"typ": type_of(kind), "kid": keys.thumbprint(keys.public_raw(key))}, payload, key)


def open(kind: str, text: str, keys: Collection[bytes], caps: Caps) -> dict[str, object]:  # noqa: A001 - read as sealed.open
    """The claims of a statement of this kind, signed by one of these keys.

    Args:
        kind: the expected kind.
        text: compact JWS.
        keys: the raw keys that may sign it.
        caps: the bounds.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_WRONG_KIND` or `STATEMENT_UNTRUSTED`.
    """
    # [STM-1] bounded, one spelling, closed header
    unverified = jws.split(text, most_bytes=caps.statement_bytes)
    header = unverified.header
    if header.keys() != _HEADER or strict_json.canonical(header) != unverified.header_raw:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not the canonical header of a statement")
    # [STM-2] the kind
    if header["typ"] != type_of(kind):
        raise StatementError(FaultCode.STATEMENT_WRONG_KIND, f"not a statement of kind {kind}")
    # [STM-3] a trusted key; `kid` only says which of them
    signer = next((raw for raw in keys if _thumbprint(raw) == header["kid"]), None)
    if signer is None:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "signed by no trusted key")
    try:
        payload = jws.check(unverified, signer)
    except StatementError:
        raise
    except CapabilityError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "the trusted key is unusable") from None
    # [STM-4] canonical claims
    claims = strict_json.parse_object(payload)
    if strict_json.canonical(claims) != payload:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not canonical")
    return claims


def signer_thumbprint(text: str) -> str:
    """The thumbprint in the header of a statement that `open` has accepted: the key that signed it."""
    return str(jws.split(text, most_bytes=len(text)).header["kid"])


_thumbprint: Final = keys.thumbprint

"""Text that a person made by passkey: its members, and the assertion over them and their subject.

In place of a signature over its bytes, as a statement has, it carries the work of a browser and an authenticator.
Clauses [PSK-6] and [PSK-7].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements.claims import malformed
from capabilities.statements.people.assertion import Assertion
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Collection

TEXT_BYTES: Final = 1_536
"""Longest text: ids of 63 bytes, a client's JSON of 512 bytes, all of it in base64."""
_PARTS: Final = 5
"""Header, members, authenticator data, client JSON and signature."""


@dataclass(frozen=True, slots=True)
class PasskeyText:
    """Such a text, read and not yet believed.

    Attributes:
        members: as stated, canonical.
        assertion: still to be checked.
        key: raw key of the registered credential that it names.
    """

    members: dict[str, object]
    assertion: Assertion
    key: bytes


def is_one(text: str) -> bool:
    """True where the text is formed as one by passkey, and not as a signed statement."""
    return text.count(".") == _PARTS - 1


def compose(typ: str, members: dict[str, object], assertion: Assertion, *, key: bytes) -> str:
    """The text.

    Args:
        typ: of the header.
        members: what the person states.
        assertion: over their challenge.
        key: raw public key of the credential.
    """
    header = strict_json.canonical({"kid": keys.thumbprint(key), "typ": typ})
    parts = header, strict_json.canonical(members), assertion.authenticator, assertion.client, assertion.signature
    return ".".join(map(keys.b64u, parts))


def read(typ: str, text: str, credentials: Collection[bytes]) -> PasskeyText:
    """The text, bounded, in its one spelling, by a registered credential.

    Args:
        typ: the expected type.
        text: to read.
        credentials: raw public keys of the passkeys that may make one.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_WRONG_KIND` or `STATEMENT_UNTRUSTED`.
    """
    # 1. bounded, one spelling, closed header
    if len(text) > TEXT_BYTES or not is_one(text):
        raise malformed(f"not five parts of at most {TEXT_BYTES} bytes")
    try:
        header_raw, members_raw, authenticator, client, signature = map(keys.unb64u, text.split("."))
    except BadKeyError:
        raise malformed("not canonical base64url") from None
    header, members = strict_json.parse_object(header_raw), strict_json.parse_object(members_raw)
    if header.keys() != {"kid", "typ"} or strict_json.canonical(header) != header_raw:
        raise malformed("not the canonical header of a text by passkey")
    if header["typ"] != typ:
        raise StatementError(FaultCode.STATEMENT_WRONG_KIND, f"not of type {typ}")
    if strict_json.canonical(members) != members_raw:
        raise malformed("not canonical")
    # 2. a registered credential; `kid` only says which of them
    key = next((raw for raw in credentials if keys.thumbprint(raw) == header["kid"]), None)
    if key is None:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "by no registered passkey")
    return PasskeyText(members, Assertion(authenticator, client, signature), key)

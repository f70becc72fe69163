"""Intent: a person's wish, signed with that person's own key, and named by the delegation that serves it.

An intent allows nothing: the token does. The token's first purpose says `intent:` and the SHA-256 of the intent's text,
so the sponsor, who signs the request for the token, lends for exactly this intent. Clause [STM-9] in docs/spec.md.
"""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Body, Name, Nonce, Whole, lasting, read, stated
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain

KIND: Final = "intent"
LIFETIME_S: Final = 86_400
"""Longest life of an intent: that of the token that is issued for it (`Caps.lifetime_s`)."""
_PURPOSE: Final = re.compile(r"intent:([0-9a-f]{64})(?: .*)?", re.DOTALL)


class Intent(Form, frozen=True):
    """Wish of a person, in an object of a named form.

    Attributes:
        subject: the person's id.
        schema: name of the form of the body.
        body: canonical JSON (RFC 8785) of an object; its numbers are integers.
        nonce: 16 to 64 base64url characters, fresh for each intent: two that want the same are two.
        at, not_after: when it was signed, and until when it counts; seconds since the epoch, at most `LIFETIME_S`
            apart.
    """

    subject: Name
    schema: Name
    body: Body
    nonce: Nonce
    at: Whole
    not_after: Whole


def sign(intent: Intent, key: PrivateKey) -> str:
    """The intent, signed by the person.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when the body is no canonical JSON object.
    """
    return statement_form.seal(KIND, plain(intent) | {"body": stated(intent.body)}, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Intent:  # noqa: A001 - read as intent.open
    """The intent, signed by one of these keys: those of people, and of nobody else.

    Raises:
        StatementError: as `sealed.open`; also for a body that is too long, and one that lives longer than
            `LIFETIME_S` or not at all.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Intent:
    intent = read(Intent, claims)
    lasting(intent.at, intent.not_after, LIFETIME_S)
    return intent


def refusal(intent: Intent, *, subject: str, at: float, caps: Caps) -> Fault | None:
    """None when the intent is this person's and counts now; else the first fault ([STM-9]).

    Args:
        intent: opened with the keys of people.
        subject: the person whose key signed it.
        at: seconds since the epoch.
        caps: the bounds.
    """
    if intent.subject != subject:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "STM-9", "signed by another person than it names")
    if not intent.at <= at + caps.skew_s:
        return Fault(FaultCode.NOT_YET_VALID, "STM-9")
    if not at < intent.not_after:
        return Fault(FaultCode.EXPIRED, "STM-9")
    return None


def digest_of(text: str) -> str:
    """SHA-256 (hex) of an intent's text, which a delegation names."""
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def purpose(digest: str, words: str = "") -> str:
    """The purpose of a token that is issued for an intent, e.g. "intent:… sort the red parts"."""
    return f"intent:{digest} {words}".rstrip(" ")


def bound(chain: Chain) -> str:
    """The intent digest that a chain's delegation states, or "" when it states none.

    Only the first purpose counts: it stands in the authority block, for a request that the sponsor signed. What a
    holder writes as the purpose of a further hop binds nothing.
    """
    match = _PURPOSE.fullmatch(chain.hops[0].purpose)
    return "" if match is None else match.group(1)

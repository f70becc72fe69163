"""How the asks of one PEP stand, as the identity provider sees it, with the votes and openings as people signed them.

The provider carries votes and cannot make one: the PEP verifies each with its approver's registered key.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.ask import ID
from capabilities.statements.claims import Claims, malformed, unique

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "answers"
NONCE: Final = re.compile(r"[A-Za-z0-9_-]{16,64}", re.ASCII)
STATES: Final = frozenset({"open", "granted", "denied", "withdrawn", "expired"})
ASKS: Final = 256
VOTES: Final = 16
OPENINGS: Final = 64
"""Most asks of one statement, votes on one ask, and openings."""


@dataclass(frozen=True, slots=True)
class AnsweredAsk:
    """How one ask stands: its state as the identity provider sees it, and the votes as they were signed."""

    ask_id: str
    state: str
    votes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Answers:
    """How all asks and openings of one audience stand.

    Attributes:
        issuer, audience: of the provider, and for whom.
        nonce: the caller's, echoed: the age of the answer runs from sending it.
        as_of_ms: wall clock before the store was read, milliseconds since the epoch.
        asks: each once.
        openings: those that are not withdrawn, as they were signed.
    """

    issuer: str
    audience: str
    nonce: str
    as_of_ms: int
    asks: tuple[AnsweredAsk, ...]
    openings: tuple[str, ...]


def sign(answers: Answers, key: PrivateKey) -> str:
    """How things stand, signed by the identity provider's registry key."""
    claims: dict[str, object] = {
        "issuer": answers.issuer,
        "audience": answers.audience,
        "nonce": answers.nonce,
        "as_of_ms": answers.as_of_ms,
        "asks": [{"ask_id": a.ask_id, "state": a.state, "votes": list(a.votes)} for a in answers.asks],
        "openings": list(answers.openings),
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Answers:  # noqa: A001 - read as answers.open
    """How things stand, signed by one of these keys; the votes and openings in it are still to be verified.

    Raises:
        StatementError: as `sealed.open`.
    """
    claims = Claims(
        statement_form.open(KIND, text, keys, caps), "issuer", "audience", "nonce", "as_of_ms", "asks", "openings"
    )
    return Answers(
        issuer=claims.url("issuer"),
        audience=claims.url("audience"),
        nonce=claims.token("nonce", NONCE),
        as_of_ms=claims.integer("as_of_ms"),
        asks=unique(claims.each("asks", _answered, most=ASKS), lambda ask: ask.ask_id, "an ask"),
        openings=claims.each("openings", _text, most=OPENINGS),
    )


def _answered(value: object) -> AnsweredAsk:
    claims = Claims(value, "ask_id", "state", "votes")
    return AnsweredAsk(
        ask_id=claims.token("ask_id", ID),
        state=claims.one_of("state", STATES),
        votes=claims.each("votes", _text, most=VOTES),
    )


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise malformed("no text")
    return value

"""A person's answer to an ask: it binds the SHA-256 of the ask's text, and so every word that was shown."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.ask import ID
from capabilities.statements.claims import Claims

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "vote"
ANSWERS: Final = frozenset({"approve", "deny", "withdraw"})
USES: Final = 100
"""Most uses of one approval."""


@dataclass(frozen=True, slots=True)
class Vote:
    """A person's answer.

    Attributes:
        ask_id, nonce: of the ask.
        ask_digest: SHA-256 (hex) of the ask's text: every word of it is what was voted on.
        answer: "approve", "deny" or "withdraw" (of an earlier approval by the same person).
        approver: the person's id.
        sees_clear: the person attests to seeing the cell clear; asked for where perception was not fresh.
        uses: how often the approval may be used, at least 1.
        not_after: until when, seconds since the epoch.
        at: when it was signed, seconds since the epoch.
    """

    ask_id: str
    nonce: str
    ask_digest: str
    answer: str
    approver: str
    sees_clear: bool
    uses: int
    not_after: int
    at: int


NAMES: Final = tuple(field.name for field in fields(Vote))


def sign(vote: Vote, key: PrivateKey) -> str:
    """The vote, signed by the person."""
    return statement_form.sign(KIND, {name: getattr(vote, name) for name in NAMES}, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Vote:  # noqa: A001 - read as vote.open
    """The vote, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`.
    """
    claims = Claims(statement_form.open(KIND, text, keys, caps), *NAMES)
    return Vote(
        ask_id=claims.token("ask_id", ID),
        nonce=claims.token("nonce", ID),
        ask_digest=claims.hex_digest("ask_digest"),
        answer=claims.one_of("answer", ANSWERS),
        approver=claims.name("approver"),
        sees_clear=claims.boolean("sees_clear"),
        uses=claims.integer("uses", low=1, high=USES),
        not_after=claims.integer("not_after"),
        at=claims.integer("at"),
    )


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a statement's text: what a vote names."""
    return hashlib.sha256(text.encode("ascii")).hexdigest()


# --- ask -------------------------------------------------------------------------------------------------------------

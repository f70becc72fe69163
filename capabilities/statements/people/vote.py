"""Vote of a person on an ask: it binds the SHA-256 of the ask's text, and so every word shown."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Id, Name, Whole, read
from capabilities.values.form import Form, plain, within, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "vote"
ANSWERS: Final = frozenset({"approve", "deny", "withdraw"})
USES: Final = 100
"""Most uses of one approval."""


class Vote(Form, frozen=True):
    """A person's answer.

    Attributes:
        ask_id, nonce: of the ask.
        ask_digest: SHA-256 (hex) of the ask's text, so that the vote is on every word of it.
        answer: "approve", "deny" or "withdraw" (of an earlier approval by the same person).
        approver: the person's id.
        sees_clear: the person attests to seeing the cell clear; asked for where perception was not fresh.
        uses: how often the approval may be used, at least 1.
        not_after: until when, seconds since the epoch.
        at: when it was signed, seconds since the epoch.
    """

    ask_id: Id
    nonce: Id
    ask_digest: HexDigest
    answer: Annotated[str, words(*ANSWERS)]
    approver: Name
    sees_clear: bool
    uses: Annotated[int, within(1, USES)]
    not_after: Whole
    at: Whole


NAMES: Final = Vote.__struct_fields__


def sign(vote: Vote, key: PrivateKey) -> str:
    """The vote, signed by the person."""
    return statement_form.seal(KIND, plain(vote), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Vote:  # noqa: A001 - read as vote.open
    """The vote, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Vote:
    return read(Vote, claims)


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a statement's text, which a vote names."""
    return hashlib.sha256(text.encode("ascii")).hexdigest()

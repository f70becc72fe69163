"""Standing of the asks of one PEP, with votes and openings as people signed them.

The provider carries votes and cannot make one: the PEP verifies each with its approver's registered key.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Id, Nonce, Url, Whole, read, unique
from capabilities.values.form import Form, plain, upto, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "answers"
STATES: Final = frozenset({"open", "granted", "denied", "withdrawn", "expired"})
ASKS: Final = 256
VOTES: Final = 16
OPENINGS: Final = 64
ENVELOPES: Final = 8
CLEARINGS: Final = 16
"""Most asks of one statement, votes on one ask, openings, envelopes, and clearings."""


class AnsweredAsk(Form, frozen=True):
    """Standing of one ask: its state as the identity provider sees it, and the votes as they were signed."""

    ask_id: Id
    state: Annotated[str, words(*STATES)]
    votes: Annotated[tuple[str, ...], upto(VOTES)]


class Answers(Form, frozen=True):
    """Standing of all asks and openings of one audience.

    Attributes:
        issuer, audience: the provider, and the enforcement point that it answers.
        nonce: the caller's, echoed: the age of the answer runs from sending it.
        as_of_ms: wall clock before the store was read, milliseconds since the epoch.
        asks: each once.
        openings: those that are not withdrawn, as they were signed.
        envelopes: likewise.
        clearings: those of the newest latch, as people made them.
    """

    issuer: Url
    audience: Url
    nonce: Nonce
    as_of_ms: Whole
    asks: Annotated[tuple[AnsweredAsk, ...], upto(ASKS)]
    openings: Annotated[tuple[str, ...], upto(OPENINGS)]
    envelopes: Annotated[tuple[str, ...], upto(ENVELOPES)] = ()
    clearings: Annotated[tuple[str, ...], upto(CLEARINGS)] = ()


def sign(answers: Answers, key: PrivateKey) -> str:
    """Answers signed by the identity provider's registry key."""
    return statement_form.seal(KIND, plain(answers), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Answers:  # noqa: A001 - read as answers.open
    """Answers signed by one of these keys; the votes and openings in them are still to be verified.

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Answers:
    answers = read(Answers, claims)
    unique(answers.asks, lambda ask: ask.ask_id, "an ask")
    return answers

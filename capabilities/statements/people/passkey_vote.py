"""Vote of a person by passkey: the members of a vote, asserted together with every word of the ask.

Clause [PSK-6].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements import claims
from capabilities.statements.people import ask as asks
from capabilities.statements.people import passkey_text
from capabilities.statements.people.assertion import Assertion, Word, challenge, check
from capabilities.statements.people.passkey_text import TEXT_BYTES, is_one
from capabilities.statements.people.vote import Vote
from capabilities.values.form import plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.statements.people.ask import Ask
    from capabilities.statements.people.assertion import RelyingParty

__all__ = ["TYPE", "VOTE_BYTES", "challenge_of", "compose", "is_one", "open"]

TYPE: Final = "ztpm-passkey-vote"
VOTE_BYTES: Final = TEXT_BYTES
"""Longest text."""


def challenge_of(vote: Vote, ask: Ask) -> bytes:
    """The challenge that the person's authenticator signs: every member of the ask, and of the vote.

    Args:
        vote: the answer, with its author.
        ask: the ask that the person was shown.
    """
    return challenge(Word.VOTE, {"ask": asks.claims(ask), "vote": plain(vote)})


def compose(vote: Vote, assertion: Assertion, *, key: bytes) -> str:
    """The text of the vote.

    Args:
        vote: the answer.
        assertion: over `challenge_of` it.
        key: raw public key of the credential.
    """
    return passkey_text.compose(TYPE, plain(vote), assertion, key=key)


def open(text: str, credentials: Collection[bytes], *, ask: Ask, party: RelyingParty) -> tuple[Vote, bytes]:  # noqa: A001 - read as passkey_vote.open
    """The vote, and the raw key of the credential by which it was made.

    Args:
        text: of the vote.
        credentials: raw public keys of the passkeys that may make one.
        ask: the ask that it is on.
        party: the pinned relying party.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_WRONG_KIND` or `STATEMENT_UNTRUSTED`.
    """
    found = passkey_text.read(TYPE, text, credentials)
    vote = claims.read(Vote, found.members)
    check(found.assertion, expected=challenge_of(vote, ask), party=party, key=found.key)
    return vote, found.key

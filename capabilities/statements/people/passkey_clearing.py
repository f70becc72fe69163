"""Clearing of a latch by passkey: the members of a clearing, asserted together with every word of the latch.

Clause [PSK-7].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.people import clearing as clearings
from capabilities.statements.people import latch as latches
from capabilities.statements.people import passkey_text
from capabilities.statements.people.assertion import Assertion, Word, challenge, check
from capabilities.values.form import plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.statements.people.assertion import RelyingParty
    from capabilities.statements.people.clearing import Clearing
    from capabilities.statements.people.latch import Latch

TYPE: Final = "ztpm-passkey-clearing"


def challenge_of(clearing: Clearing, latch: Latch) -> bytes:
    """The challenge that the person's authenticator signs: every member of the latch, and of the clearing.

    Args:
        clearing: with its author.
        latch: the latch that the person was shown.
    """
    return challenge(Word.CLEARING, {"latch": latches.claims(latch), "clearing": plain(clearing)})


def compose(clearing: Clearing, assertion: Assertion, *, key: bytes) -> str:
    """The text of the clearing.

    Args:
        clearing: what is stated.
        assertion: over `challenge_of` it.
        key: raw public key of the credential.
    """
    return passkey_text.compose(TYPE, plain(clearing), assertion, key=key)


def open(  # noqa: A001 - read as passkey_clearing.open
    text: str, credentials: Collection[bytes], *, latch: Latch, party: RelyingParty
) -> tuple[Clearing, bytes]:
    """The clearing, and the raw key of the credential by which it was made.

    Args:
        text: of the clearing.
        credentials: raw public keys of the passkeys that may make one.
        latch: the latch that it is of.
        party: the pinned relying party.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_WRONG_KIND` or `STATEMENT_UNTRUSTED`.
    """
    found = passkey_text.read(TYPE, text, credentials)
    stated = clearings.read_claims(found.members)
    check(found.assertion, expected=challenge_of(stated, latch), party=party, key=found.key)
    return stated, found.key

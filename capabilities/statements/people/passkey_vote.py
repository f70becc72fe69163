"""Vote of a person by passkey: the members of a vote, asserted together with every word of the ask.

In place of a signature over its bytes, as a `vote` has, the text carries what a browser and an authenticator made.
Clause [PSK-6].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements.claims import malformed, read
from capabilities.statements.people import ask as asks
from capabilities.statements.people.assertion import Assertion, Word, challenge, check
from capabilities.statements.people.vote import Vote
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, FaultCode, StatementError
from capabilities.values.form import plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.statements.people.ask import Ask
    from capabilities.statements.people.assertion import RelyingParty

TYPE: Final = "ztpm-passkey-vote"
VOTE_BYTES: Final = 1_536
"""Longest text: ids of 63 bytes, a client's JSON of 512 bytes, all of it in base64."""
_PARTS: Final = 5
"""Header, vote, authenticator data, client JSON and signature."""


def is_one(text: str) -> bool:
    """True where the text is formed as a vote by passkey, and not as a signed statement."""
    return text.count(".") == _PARTS - 1


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
    header = strict_json.canonical({"kid": keys.thumbprint(key), "typ": TYPE})
    parts = header, strict_json.canonical(plain(vote)), assertion.authenticator, assertion.client, assertion.signature
    return ".".join(map(keys.b64u, parts))


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
    # 1. bounded, one spelling, closed header
    if len(text) > VOTE_BYTES or not is_one(text):
        raise malformed(f"not five parts of at most {VOTE_BYTES} bytes")
    try:
        header_raw, vote_raw, authenticator, client, signature = map(keys.unb64u, text.split("."))
    except BadKeyError:
        raise malformed("not canonical base64url") from None
    header, claims = strict_json.parse_object(header_raw), strict_json.parse_object(vote_raw)
    if header.keys() != {"kid", "typ"} or strict_json.canonical(header) != header_raw:
        raise malformed("not the canonical header of a vote by passkey")
    if header["typ"] != TYPE:
        raise StatementError(FaultCode.STATEMENT_WRONG_KIND, "not a vote by passkey")
    if strict_json.canonical(claims) != vote_raw:
        raise malformed("not canonical")
    # 2. a registered credential; `kid` only says which of them
    key = next((raw for raw in credentials if keys.thumbprint(raw) == header["kid"]), None)
    if key is None:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "by no registered passkey")
    # 3. the members, and the assertion over them and over the ask
    vote = read(Vote, claims)
    check(Assertion(authenticator, client, signature), expected=challenge_of(vote, ask), party=party, key=key)
    return vote, key

"""Counting of votes and openings, each verified with its author's registered key. Pure.

The identity provider carries votes and cannot make one. What it says about the state of an ask is advice; this decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements.people import envelope as envelope_statement
from capabilities.statements.people import opening as opening_statement
from capabilities.statements.people import passkey_vote
from capabilities.statements.people import vote as vote_statement
from capabilities.statements.people.assertion import relying_party
from capabilities.statements.statement_form import signer_thumbprint
from capabilities.values.errors import CapabilityError, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.statements.people.ask import Ask
    from capabilities.statements.people.envelope import Envelope
    from capabilities.statements.people.opening import Opening
    from capabilities.statements.people.vote import Vote
    from capabilities.values.caps import Caps
    from pep.base.ports import Approvers

VOTE_LIFETIME_S: Final = 3_600
"""Longest validity of a vote from its signing, the provider's rule too."""
_RANK: Final = {"approve": 0, "withdraw": 1, "deny": 2}
"""Of two answers signed in the same second the stricter one is the newer."""


class VoteFault(StrEnum):
    """Reason why a signed vote or opening does not count, beside the faults of a statement."""

    VOTE_NOT_FOR_THIS_ASK = "VOTE_NOT_FOR_THIS_ASK"
    VOTE_NOT_YOURS = "VOTE_NOT_YOURS"
    VOTE_OUT_OF_TIME = "VOTE_OUT_OF_TIME"
    NOT_PERMITTED = "NOT_PERMITTED"
    OPENING_NOT_FOR_US = "OPENING_NOT_FOR_US"
    ENVELOPE_NOT_FOR_US = "ENVELOPE_NOT_FOR_US"


@dataclass(frozen=True, slots=True)
class RejectedStatement:
    """A statement that is not believed, and why."""

    code: VoteFault | FaultCode


@dataclass(frozen=True, slots=True)
class VerifiedVote:
    """A verified vote, its text, and the raw key that signed it."""

    text: str
    vote: Vote
    key: bytes


@dataclass(frozen=True, slots=True)
class VerifiedOpening:
    """A verified opening, its text, and the raw key that signed it."""

    text: str
    opening: Opening
    key: bytes


@dataclass(frozen=True, slots=True)
class VerifiedEnvelope:
    """A verified envelope, its text, and the raw key that signed it."""

    text: str
    envelope: Envelope
    key: bytes


class Count(Enum):
    """Outcome of the votes on an ask."""

    OPEN = "open"
    GRANTED = "granted"
    DENIED = "denied"
    WITHDRAWN = "withdrawn"


@dataclass(frozen=True, slots=True)
class Tally:
    """The votes on one ask, counted.

    Attributes:
        count: outcome of the votes.
        approvers: the different people who approve, sorted.
        uses: number of uses of the approval in all: the least of the votes; 0 when nobody approves.
        not_after: seconds since the epoch, the earliest of theirs; 0 when nobody approves.
        sees_clear: every one of them attests to seeing the cell clear.
    """

    count: Count
    approvers: tuple[str, ...]
    uses: int
    not_after: int
    sees_clear: bool


def read_vote(
    text: str, question: Ask, question_text: str, people: Approvers, *, at: float, caps: Caps
) -> VerifiedVote | RejectedStatement:
    """The vote, when a registered approver signed it or made it by passkey, in time, for exactly this ask.

    Args:
        text: of the vote.
        question: the ask; its issuer names the relying party of passkeys.
        question_text: its text, which the vote binds.
        people: registered approvers.
        at: now, seconds since the epoch.
        caps: bounds.
    """
    try:
        vote, key = _opened(text, question, people, caps)
    except CapabilityError as error:
        return RejectedStatement(error.code)
    if key is None:
        return RejectedStatement(VoteFault.VOTE_NOT_YOURS)
    if keys.thumbprint(key) == question.agent_key:
        return RejectedStatement(VoteFault.NOT_PERMITTED)
    asked = (question.ask_id, question.nonce, vote_statement.digest_of(question_text))
    if (vote.ask_id, vote.nonce, vote.ask_digest) != asked:
        return RejectedStatement(VoteFault.VOTE_NOT_FOR_THIS_ASK)
    signed_in_time = question.asked_at <= vote.at <= at + caps.skew_s
    if not (signed_in_time and vote.at < vote.not_after <= vote.at + VOTE_LIFETIME_S + caps.skew_s):
        return RejectedStatement(VoteFault.VOTE_OUT_OF_TIME)
    return VerifiedVote(text, vote, key)


def _opened(text: str, question: Ask, people: Approvers, caps: Caps) -> tuple[Vote, bytes | None]:
    """The vote, and the key or passkey of its own author that made it; None where that is another person's.

    Raises:
        CapabilityError: as `vote.open` and `passkey_vote.open`.
    """
    if passkey_vote.is_one(text):
        party = relying_party(question.issuer)
        if party is None:
            raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "no passkey belongs to an address")
        passkeys = people.passkeys()
        vote, key = passkey_vote.open(text, list(passkeys), ask=question, party=party)
        return vote, key if passkeys[key] == vote.approver else None
    approvers = people.approvers()
    vote = vote_statement.open(text, list(approvers), caps)
    return vote, own_key(approvers, vote.approver, signer_thumbprint(text))


def registered(people: Approvers) -> dict[bytes, str]:
    """Registered approvers by raw key, passkeys too: however many a person has, they are one voter."""
    return {**people.passkeys(), **people.approvers()}


def read_opening(
    text: str, audience: str, approvers: Mapping[bytes, str], *, caps: Caps
) -> VerifiedOpening | RejectedStatement:
    """The opening, when a registered approver signed it for this audience.

    Args:
        text: of the opening.
        audience: canonical URL of this server.
        approvers: registered approvers by raw key.
        caps: bounds.
    """
    try:
        opening = opening_statement.open(text, list(approvers), caps)
    except CapabilityError as error:
        return RejectedStatement(error.code)
    key = own_key(approvers, opening.opener, signer_thumbprint(text))
    if key is None:
        return RejectedStatement(VoteFault.VOTE_NOT_YOURS)
    if opening.audience != audience:
        return RejectedStatement(VoteFault.OPENING_NOT_FOR_US)
    return VerifiedOpening(text, opening, key)


def read_envelope(
    text: str, audience: str, approvers: Mapping[bytes, str], *, caps: Caps
) -> VerifiedEnvelope | RejectedStatement:
    """The envelope, when a registered approver signed it for this audience.

    Args:
        text: of the envelope.
        audience: canonical URL of this server.
        approvers: registered approvers by raw key.
        caps: bounds.
    """
    try:
        envelope = envelope_statement.open(text, list(approvers), caps)
    except CapabilityError as error:
        return RejectedStatement(error.code)
    key = own_key(approvers, envelope.approver, signer_thumbprint(text))
    if key is None:
        return RejectedStatement(VoteFault.VOTE_NOT_YOURS)
    if envelope.audience != audience:
        return RejectedStatement(VoteFault.ENVELOPE_NOT_FOR_US)
    return VerifiedEnvelope(text, envelope, key)


def own_key(approvers: Mapping[bytes, str], person: str, signer: str) -> bytes | None:
    """The person's key with this thumbprint."""
    own = (key for key, owner in approvers.items() if owner == person)
    return next((key for key in own if keys.thumbprint(key) == signer), None)


def tally(ballots: Iterable[VerifiedVote], question: Ask, approvers: Mapping[bytes, str]) -> Tally:
    """Count of the votes: each person once, the newest vote counting, by people who are registered now.

    One deny ends the ask for good. A withdrawal ends what its author approved, and the ask with it. Of two people that
    are wanted, one votes with an operator key.

    Args:
        ballots: verified votes on `question`.
        question: the ask, with the number of different people wanted; of two at most one is the sponsor.
        approvers: people who are registered now, by raw key.
    """
    standing = [ballot for ballot in ballots if approvers.get(ballot.key) == ballot.vote.approver]
    newest = {
        ballot.vote.approver: ballot
        for ballot in sorted(standing, key=lambda ballot: (ballot.vote.at, _RANK[ballot.vote.answer]))
    }
    approving = {person: ballot.vote for person, ballot in newest.items() if ballot.vote.answer == "approve"}
    # [PSK-9] a page may have been made by a changed script, and a terminal draws the ask from its own copy
    keyed = any(person in approving and not passkey_vote.is_one(ballot.text) for person, ballot in newest.items())
    enough = len(approving) >= question.approvers and (keyed or question.approvers == 1)
    if any(ballot.vote.answer == "deny" for ballot in standing):
        count = Count.DENIED
    elif any(ballot.vote.answer == "withdraw" for ballot in newest.values()):
        count = Count.WITHDRAWN
    elif enough:
        count = Count.GRANTED
    else:
        count = Count.OPEN
    return Tally(
        count=count,
        approvers=tuple(sorted(approving)),
        uses=min((vote.uses for vote in approving.values()), default=0),
        not_after=min((vote.not_after for vote in approving.values()), default=0),
        sees_clear=bool(approving) and all(vote.sees_clear for vote in approving.values()),
    )

"""Asks, votes and openings as the identity provider keeps them, and how an ask stands at an instant.

How an ask stands is always worked out from its votes and the time, never stored: silence denies by itself, and no timer
has to run for that.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.keys import jws
from capabilities.statements.people import passkey_vote
from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.caps import Caps

STANDING_ASKS: Final = 40
"""Most asks of one audience that are open or granted at a time.

Each holds two votes at most then, by passkey of at most 1,536 bytes: all of them, all openings and 8 envelopes of 4 KiB
always fit one `answers` statement (256 KiB), so that what is not in it is not approved. More than people can answer in
the 120 s that an approval lives by default.
"""
OPENINGS: Final = 16
"""Most openings of one audience in force at a time; a quarter of those that an `answers` statement may hold."""
ANSWERED_MEMORY_S: Final = 600
"""Seconds for which an ended ask is still told to its enforcement point (the wire contract of approvals)."""


class AskState(StrEnum):
    """State of an ask, as `capabilities.statements.people.answers.STATES` spells it."""

    OPEN = "open"
    GRANTED = "granted"
    DENIED = "denied"
    WITHDRAWN = "withdrawn"
    EXPIRED = "expired"


class Answer(StrEnum):
    """Answer of a vote, as `capabilities.statements.people.vote.ANSWERS` spells it."""

    APPROVE = "approve"
    DENY = "deny"
    WITHDRAW = "withdraw"


@dataclass(frozen=True, slots=True)
class AskRecord:
    """Part of an ask that decides; all the rest is in its text.

    Attributes:
        ask_id, nonce: 32 hex digits each.
        digest: SHA-256 (hex) of its text.
        pep, audience: who asks, for which server.
        agent, sponsor: the leaf of the chain and its human root.
        approvers: how many different people must approve.
        fresh: whether it was assessed on fresh perception, or needs none; if not, every approver attests to seeing the
            cell clear.
        asked_at, expires_at: seconds since the epoch.
        trace_id: of the trace that the enforcement point asked in; empty where it named none. It is not signed.
    """

    ask_id: str
    nonce: str
    digest: str
    pep: str
    audience: str
    agent: str
    sponsor: str
    approvers: int
    fresh: bool
    asked_at: int
    expires_at: int
    trace_id: str = ""


@dataclass(frozen=True, slots=True)
class VoteRecord:
    """A vote that was cast.

    Attributes:
        approver, answer, not_after: as it says.
        active: its approver is one still; an approval by a person who has ended since, or has the role no longer, does
            not count.
        text: as it was signed.
    """

    approver: str
    answer: Answer
    not_after: int
    active: bool
    text: str


@dataclass(frozen=True, slots=True)
class Asked:
    """An ask with all its votes, in the order in which they came."""

    ask: AskRecord
    votes: tuple[VoteRecord, ...] = ()
    ended: bool = False
    """Its agent or its sponsor has ended, and the ask too."""

    def enough(self, approvals: Iterable[VoteRecord]) -> bool:
        """True where these are as many people as it wants; of two one has an operator key ([PSK-9])."""
        people = {vote.approver: passkey_vote.is_one(vote.text) for vote in approvals}
        return len(people) >= self.ask.approvers and (self.ask.approvers == 1 or not all(people.values()))

    def state(self, at_ms: int) -> AskState:
        """State of the ask at this wall-clock time.

        It is advice: the enforcement point counts the votes itself.
        """
        answers = {vote.answer for vote in self.votes}
        approvals = [vote for vote in self.votes if vote.answer is Answer.APPROVE and vote.active]
        if Answer.DENY in answers:  # one denial ends it
            return AskState.DENIED
        if Answer.WITHDRAW in answers:
            return AskState.WITHDRAWN
        if self.ended:
            return AskState.EXPIRED
        # An approval that lapsed ends the ask too: two that never held together are not two.
        if not all(at_ms <= vote.not_after * 1_000 for vote in approvals):
            return AskState.EXPIRED
        if self.enough(approvals):
            return AskState.GRANTED
        return AskState.OPEN if at_ms < self.ask.expires_at * 1_000 else AskState.EXPIRED


@dataclass(frozen=True, slots=True)
class OpeningRecord:
    """A person's leave to ask for a safety-critical act.

    Attributes:
        opening_id: 32 hex digits.
        digest: SHA-256 (hex) of its text.
        opener: the person who signed it.
        audience, agent, object, operation: the acts that it opens.
        not_before, not_after: seconds since the epoch.
        closed: whether a person took it back.
        text: as it was signed.
    """

    opening_id: str
    digest: str
    opener: str
    audience: str
    agent: str
    object: str
    operation: str
    not_before: int
    not_after: int
    closed: bool
    text: str

    def over(self, at_ms: int) -> bool:
        """Taken back, or past its end."""
        return self.closed or not at_ms <= self.not_after * 1_000

    def in_force(self, at_ms: int) -> bool:
        """Begun, not over."""
        return self.not_before * 1_000 <= at_ms and not self.over(at_ms)


def stated(text: str, caps: Caps) -> dict[str, str]:
    """The texts among a statement's claims, and its signer's thumbprint as `kid`. Nothing of it is verified.

    Good for finding the rows that a judgement must see, and for nothing else; empty for a text that cannot be read.
    """
    try:
        unverified = jws.split(text, most_bytes=caps.statement_bytes)
        claims = strict_json.parse_object(unverified.payload_raw) | {"kid": unverified.header.get("kid")}
    except CapabilityError:
        return {}
    return {name: value for name, value in claims.items() if isinstance(value, str)}

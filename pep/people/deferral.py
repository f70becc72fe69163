"""One deferral: the question, the votes on it, its uses, and its records in the journal."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias, assert_never

from capabilities.keys import keys
from pep.people.votes import Count, tally
from policies.evidence.evidence import ApprovalReading
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.statements.people import ask as ask_statement
    from capabilities.values.chain import Chain
    from capabilities.values.scope import Tier
    from pep.people.votes import Tally, VerifiedVote
    from policies.evidence.model import Request

RESERVED_MS: Final = 5_000
"""Longest reservation of a use (DESIGN section 6)."""
PICTURE_LOST: Final = "ASK_PICTURE_DIFFERS"
"""The provider's code for an ask that comes without the picture that it names."""
NEVER_MS: Final = 2**31
"""Age of a word that was never heard."""

Holder: TypeAlias = tuple[str, str, str, str]
"""Agent, thumbprint of its key, digest of the request, and id of the mandate under which it asks, or ""."""
Key: TypeAlias = tuple[Holder, frozenset[str], "Tier | None"]
"""A question: holder, reasons, tier. An answer about a glass is none about a person."""


class AskState(Enum):
    """State of a deferral."""

    OPEN = "open"
    GRANTED = "granted"
    DENIED = "denied"
    WITHDRAWN = "withdrawn"
    EXPIRED = "expired"
    """Nobody answered in time."""
    REFUSED = "refused"
    """The provider asks people no more for this agent now."""
    LOST = "lost"
    """Nobody was asked: its picture was gone with the process that made it. It is to be asked anew."""


ANSWERED: Final = {
    Count.GRANTED: AskState.GRANTED,
    Count.DENIED: AskState.DENIED,
    Count.WITHDRAWN: AskState.WITHDRAWN,
}
"""State of a deferral by the count of its votes."""


@dataclass(frozen=True, slots=True)
class AskNotice:
    """Notice of a deferral for the caller.

    Attributes:
        ask_id: the request id of the call that opened it.
        agent: leaf agent that asked.
        request_digest: digest of its request.
        reason: reason of the deferral.
        expires_ms: monotonic time of its end.
        expires_at: the same in seconds since the epoch, for people.
        url: the page on which people see it.
        text: the signed ask.
        trace_id: of the trace in which it was asked; empty where none is known. It is not signed.
        pictured: it names a picture, since it is of a motion.
        picture: text of that picture; "" of an act without motion, and after a restart.
    """

    ask_id: str
    agent: str
    request_digest: str
    reason: str
    expires_ms: int
    expires_at: float
    url: str
    text: str
    trace_id: str = ""
    pictured: bool = False
    picture: str = ""


@dataclass(slots=True)
class Deferral:
    """A deferral with its votes and uses.

    Attributes:
        ask, question, key: the ask, and the question it puts.
        state: state of the deferral.
        ballots: verified votes by the digest of their text; what was heard once is not unheard.
        rejected: digests of votes that do not count.
        word_ms: monotonic time at which the nonce of the provider's newest word about it was sent; None since start.
        used: the request that consumed each use.
        reserved: the request that holds each use, and until when (monotonic).
        not_after: latest end of any vote, seconds since the epoch.
        posted: the provider has it.
        told: its end was told to its agent.
        refused_until_ms: until when the same question is not put again (monotonic).
    """

    ask: AskNotice
    question: ask_statement.Ask
    key: Key
    state: AskState = AskState.OPEN
    ballots: dict[str, VerifiedVote] = field(default_factory=dict)
    rejected: set[str] = field(default_factory=set)
    word_ms: int | None = None
    used: dict[int, str] = field(default_factory=dict)
    reserved: dict[int, tuple[str, int]] = field(default_factory=dict)
    not_after: int = 0
    posted: bool = False
    told: bool = False
    refused_until_ms: int = 0

    @property
    def awaits_word(self) -> bool:
        """It was granted before this process began, and its votes are still to be fetched again."""
        return self.state is AskState.GRANTED and self.word_ms is None

    def count(self, registered: Mapping[bytes, str]) -> Tally:
        """Its votes, counted for the approvers who are registered now."""
        return tally(self.ballots.values(), self.question, registered)

    def standing(self, counted: Tally, now_s: float) -> str:
        """Standing in the words of an `ApprovalReading`; "" where it is no evidence of anything."""
        match self.state:
            case AskState.EXPIRED | AskState.REFUSED | AskState.LOST:
                return ""
            case AskState.GRANTED if self.word_ms is None:
                return "open"
            case AskState.GRANTED if counted.count is not Count.GRANTED:
                return "withdrawn"  # the person who approved is no approver any more
            case AskState.GRANTED if len(self.used) >= counted.uses:
                return "used"
            case AskState.GRANTED:
                return "granted" if now_s <= counted.not_after else "expired"
            case AskState.OPEN | AskState.DENIED | AskState.WITHDRAWN:
                return str(self.state.value)
            case _:
                assert_never(self.state)

    def next_use(self, request_id: str, uses: int, now_ms: int) -> tuple[int, int]:
        """(how many uses are left to this request, number of the next one or 0); reservations that are over lapse."""
        self.reserved = {use: held for use, held in self.reserved.items() if now_ms <= held[1]}
        free = [
            use
            for use in range(1, uses + 1)
            if use not in self.used and (use not in self.reserved or self.reserved[use][0] == request_id)
        ]
        return len(free), free[0] if free else 0

    def reserve(self, request_id: str, at_ms: int, counted: Tally, standing: str) -> ApprovalReading:
        """The reading for a request; the use that it names is reserved for the request.

        Args:
            request_id: of the request.
            at_ms: monotonic time of the evidence.
            counted: its votes.
            standing: standing of the deferral.
        """
        question = self.question
        left, use = self.next_use(request_id, counted.uses, at_ms)
        if standing == "granted" and left:
            self.reserved[use] = (request_id, at_ms + RESERVED_MS)
        return ApprovalReading(
            ask_id=question.ask_id,
            state=standing,
            reasons=frozenset(question.reasons),
            tier=question.tier,
            index_milli=question.index_milli,
            contributors=frozenset((c.kind, c.object) for c in question.contributors)
            | {fact.contributor for fact in question.facts if fact.raises},
            start_urad=question.start_urad,
            model_digest=question.model_digest,
            policy_digest=question.policy_digest,
            approvers=counted.approvers,
            sponsor=question.sponsor,
            opening_id=question.opening_id,
            sees_clear=counted.sees_clear,
            uses_left=left,
            use=use,
            not_after=counted.not_after,
            # a word that came while the evidence was collected is as good as new
            age_ms=NEVER_MS if self.word_ms is None else max(0, at_ms - self.word_ms),
        )

    def consume(self, request_id: str, use: int, now_ms: int) -> bool:
        """True when the use was reserved for this request, in time, and is its own from now on."""
        held = self.reserved.get(use)
        if held is None or use in self.used or held[0] != request_id or not now_ms <= held[1]:
            return False
        self.used[use] = request_id
        del self.reserved[use]
        return True

    def release(self, request_id: str) -> None:
        """Frees the use that was only reserved for the request."""
        self.reserved = {use: held for use, held in self.reserved.items() if held[0] != request_id}

    def give_back(self, request_id: str, use: int) -> None:
        """Returns the use, if it was this request's."""
        if self.used.get(use) == request_id:
            del self.used[use]


def holder_of(chain: Chain, request: Request) -> Holder:
    """Holder of the chain, with the digest of its request."""
    return chain.leaf.agent, keys.thumbprint(chain.leaf.key), request.digest, chain.mandate_id or ""


def key_of(question: ask_statement.Ask) -> Key:
    """The key of an ask that was put."""
    holder = question.agent, question.agent_key, question.request_digest, question.mandate_id
    return holder, frozenset(question.reasons), question.tier


def opened_body(ask: AskNotice) -> dict[str, object]:
    """Body of an "ask" record: the whole signed ask, before people see it."""
    return {
        "ask_id": ask.ask_id,
        "agent": ask.agent,
        "request_digest": ask.request_digest,
        "reason": ask.reason,
        "expires_at_ms": round(ask.expires_at * 1000),
        "ask": ask.text,
        **_traced(ask),
    }


def answered_body(ask: AskNotice, counted: Tally, ballots: Iterable[VerifiedVote]) -> dict[str, object]:
    """Body of an "ask-answered" record: the count of the votes, and the votes as they were signed."""
    return {
        "ask_id": ask.ask_id,
        "request_digest": ask.request_digest,
        "state": counted.count.value,
        "approvers": list(counted.approvers),
        "uses": counted.uses,
        "not_after": counted.not_after,
        "votes": [ballot.text for ballot in ballots],
        **_traced(ask),
    }


def _traced(ask: AskNotice) -> dict[str, str]:
    return {"trace_id": ask.trace_id} if ask.trace_id else {}


def expired_body(ask_id: str, request_digest: str) -> dict[str, object]:
    """The body of an "ask-expired" record."""
    return {
        "ask_id": ask_id,
        "request_digest": request_digest,
        "effect": "DENY",
        "reason": str(Reason.APPROVAL_TIMEOUT),
    }


class Announcer(Protocol):
    """Tells people of a deferral."""

    async def announce(self, ask: AskNotice) -> AskState:
        """State of the ask after one try to tell people: `OPEN`, told or still to be told, `REFUSED` or `LOST`.

        Never raises for a provider that cannot be reached, and waits for it at most about a second.
        """
        ...

"""Asks, votes and openings: the rights to ask people, to answer, and to let a safety-critical act be asked for.

The provider takes and carries signed statements; it signs no vote. A refused act leaves no trace but its entry in the
ledger.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from capabilities.statements.people import ask as asks
from capabilities.statements.people import opening as openings
from capabilities.statements.people import passkey_vote
from capabilities.statements.people import picture as pictures
from capabilities.statements.people import vote as votes
from capabilities.statements.people.assertion import relying_party
from capabilities.statements.people.vote import digest_of
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.scope import Tier
from ztpm_idp.domain.asking.asks import (
    OPENINGS,
    STANDING_ASKS,
    Answer,
    Asked,
    AskRecord,
    AskState,
    OpeningRecord,
    VoteRecord,
)
from ztpm_idp.domain.asking.refusing import Refusing, whose
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import AskTaken, OpeningClosed, OpeningMade, VoteCast
from ztpm_idp.domain.lending.allowances import spent
from ztpm_idp.domain.lending.amounts import Used
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, RegisteredPep, RegisteredPerson, Standing
from ztpm_idp.domain.registry import active_person

if TYPE_CHECKING:
    from capabilities.statements.people.ask import Ask
    from capabilities.statements.people.opening import Opening
    from capabilities.statements.people.vote import Vote
    from ztpm_idp.domain.codes import Code
    from ztpm_idp.domain.commands import CastVote, CloseOpening, OpenTier4, TakeAsk
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

ASK_LIFETIME_S: Final = 3_600
"""Longest life of an ask, in seconds: as long as the longest approval."""
VOTE_LIFETIME_S: Final = 3_600
"""Longest life of an approval from now, in seconds (the wire contract of approvals)."""
OPENING_LIFETIME_S: Final = 3_600
"""Longest life of an opening, from its beginning and from now, in seconds: one task, not a shift."""
MINUTE_MS: Final = 60_000
HOUR_MS: Final = 3_600_000
SHARE_OF_ONE_AGENT: Final = 3
"""One agent's open asks are at most this part of the budget, a third (DESIGN section 9)."""


# --- asks -------------------------------------------------------------------------------------------------------------


def take_ask(rules: Rules, state: State, command: TakeAsk, at_ms: int) -> Outcome:
    """An enforcement point's ask, shown to people from now on; nothing happens again for the very same text.

    Revocation and stop never come here, and so are never budgeted.
    """
    known = state.asked
    refused = Refusing("ask", "" if known is None else known.ask.ask_id, command.by, command.text, None)
    # 1. The caller is an enforcement point, now, and signed this ask itself.
    pep = state.parties.get(command.by)
    if not isinstance(pep, RegisteredPep) or pep.standing is not Standing.ACTIVE:
        return refused(IdpCode.NOT_PERMITTED, "enforcement points ask")
    try:
        asked = asks.open(command.text, {pep.key}, rules.caps)
    except StatementError as error:
        return refused(error.code, error.detail)
    refused = Refusing("ask", asked.ask_id, command.by, command.text, None)
    if asked.pep != pep.id:
        return refused(IdpCode.ASK_NOT_YOURS, "the ask names another enforcement point")
    if asked.audience not in pep.audiences:
        return refused(IdpCode.NOT_PERMITTED, "the audience is not the enforcement point's")
    # 2. An id means one text, for ever.
    if known is not None:
        same = known.ask.digest == digest_of(command.text) and known.ask.pep == pep.id
        return () if same else refused(IdpCode.ASK_DIFFERS, "another ask has this id")
    # 3. What people will be shown is what it names, and can be drawn ([STM-23], [STM-24]).
    if (unlike := _picture_differs(asked, command.picture)) is not None:
        return refused(*unlike)
    # 4. It speaks of this provider, and of parties as they are registered.
    if (wrong := _against_registry(rules, state, asked)) is not None:
        return refused(*wrong)
    # 5. Its times are sane.
    if not at_ms < asked.expires_at * 1_000:
        return refused(IdpCode.ASK_OVER, "the ask would be over before anybody saw it")
    if (
        not asked.asked_at * 1_000 <= at_ms + rules.caps.skew_s * 1_000
        or not asked.expires_at - asked.asked_at <= ASK_LIFETIME_S
    ):
        return refused(IdpCode.ASK_OUT_OF_TIME, f"asked by now, for at most {ASK_LIFETIME_S} s")
    # 6. A safety-critical act rests on an opening that a person made for just this, and that is in force.
    if asked.tier is Tier.SAFETY_CRITICAL and not _opened_for(state.opening, asked, at_ms):
        return refused(IdpCode.OPENING_NOT_IN_FORCE, "no opening in force allows to ask for this")
    # 7. Waiting asks are still few enough to be read, and no agent crowds the others out.
    if (why := _budget_spent(rules, state, asked, at_ms)) is not None:
        return refused(IdpCode.ASK_BUDGET_SPENT, why)
    return (AskTaken(_record(asked, command.text, command.trace_id), command.text, command.picture),)


def _picture_differs(asked: Ask, text: str) -> tuple[Code, str] | None:
    if (pictures.digest_of(text) if text else "") != asked.picture_digest:
        return IdpCode.ASK_PICTURE_DIFFERS, "no picture with the digest that the ask names"
    try:
        if text:
            pictures.read(text)
    except StatementError as error:
        return error.code, error.detail
    return None


def _against_registry(rules: Rules, state: State, asked: Ask) -> tuple[Code, str] | None:
    if asked.issuer != rules.issuer:
        return IdpCode.ASK_CONTRADICTS_REGISTRY, "the ask is of another issuer's authority"
    match state.parties.get(asked.sponsor):
        case RegisteredPerson(standing=Standing.ACTIVE, roles=roles) if PersonRole.SPONSOR in roles:
            pass
        case RegisteredPerson():
            return IdpCode.SPONSOR_INACTIVE, "the sponsor is not active"
        case _:
            return IdpCode.NOT_FOUND, "no such sponsor"
    match state.parties.get(asked.agent):
        case RegisteredAgent(standing=Standing.ACTIVE, thumbprint=thumbprint) if thumbprint == asked.agent_key:
            return None
        case RegisteredAgent(standing=Standing.ACTIVE):
            return IdpCode.ASK_CONTRADICTS_REGISTRY, "the agent's key is another"
        case RegisteredAgent():
            return IdpCode.AGENT_INACTIVE, "the agent is not active"
        case _:
            return IdpCode.NOT_FOUND, "no such agent"


def _opened_for(opening: OpeningRecord | None, asked: Ask, at_ms: int) -> bool:
    return (
        opening is not None
        and opening.opening_id == asked.opening_id
        and (opening.audience, opening.agent) == (asked.audience, asked.agent)
        and (opening.object, opening.operation) == (asked.object, asked.operation)
        and opening.in_force(at_ms)
    )


def _budget_spent(rules: Rules, state: State, asked: Ask, at_ms: int) -> str | None:
    standing = [(other.ask, other.state(at_ms)) for other in state.standing]
    waiting = [ask for ask, how in standing if how is AskState.OPEN]
    if not len(waiting) < rules.open_asks:
        return f"{rules.open_asks} asks wait for an answer"
    share = max(1, rules.open_asks // SHARE_OF_ONE_AGENT)
    if not sum(1 for ask in waiting if ask.agent == asked.agent) < share:
        return f"{share} asks of this agent wait for an answer"
    mine = Used(asks=sum(1 for ask in waiting if ask.sponsor == asked.sponsor))
    if (of_sponsor := spent(rules, asked.sponsor, mine, "asks")) is not None:
        return of_sponsor.detail
    for most, span_ms, word in (
        (rules.asks_a_minute, MINUTE_MS, "minute"),
        (rules.asks_an_hour, HOUR_MS, "hour"),
    ):
        if not sum(1 for taken in state.taken_ms if taken > at_ms - span_ms) < most * max(1, state.approvers):
            return f"{most} asks for each approver were shown within the {word}"
    alive = sum(
        1 for ask, how in standing if how in {AskState.OPEN, AskState.GRANTED} and ask.audience == asked.audience
    )
    return None if alive < STANDING_ASKS else f"{STANDING_ASKS} asks of this audience are open or granted"


def _record(asked: Ask, text: str, trace_id: str) -> AskRecord:
    return AskRecord(
        ask_id=asked.ask_id,
        nonce=asked.nonce,
        digest=digest_of(text),
        pep=asked.pep,
        audience=asked.audience,
        agent=asked.agent,
        sponsor=asked.sponsor,
        approvers=asked.approvers,
        fresh=asked.perception in {"fresh", asks.NO_ROBOT},
        asked_at=asked.asked_at,
        expires_at=asked.expires_at,
        trace_id=trace_id,
    )


# --- votes ------------------------------------------------------------------------------------------------------------


def cast_vote(rules: Rules, state: State, command: CastVote, at_ms: int) -> Outcome:
    """An approver's own signed answer to exactly this ask, once; a withdrawal of one's own approval, once."""
    refused = Refusing("vote", command.ask_id, command.by, command.text, command.signed)
    # 1. The caller is an approver, now: never an agent, a sensor, an enforcement point.
    person = active_person(state, command.by, PersonRole.APPROVER)
    if person is None:
        return refused(IdpCode.NOT_PERMITTED, "approvers vote")
    # 2. The ask exists.
    if state.asked is None:
        return refused(IdpCode.ASK_UNKNOWN, "no such ask")
    ask = state.asked.ask
    # 3. The vote is signed by a key of the caller's own, or made by its passkey, and names the caller.
    try:
        vote = _opened(rules, ask, command, person)
    except StatementError as error:
        return refused(
            whose(rules, state, command.text, error, kind=votes.KIND, not_yours=IdpCode.VOTE_NOT_YOURS), error.detail
        )
    if vote.approver != person.id:
        return refused(IdpCode.VOTE_NOT_YOURS, "the vote names another person")
    # 4. It is for this ask, and for every word of it.
    if (vote.ask_id, vote.nonce, vote.ask_digest) != (ask.ask_id, ask.nonce, ask.digest):
        return refused(IdpCode.VOTE_NOT_FOR_THIS_ASK, "the vote is for another ask, or another text of it")
    # 5. Its times are sane.
    ahead_ms = at_ms + rules.caps.skew_s * 1_000
    if not (ask.asked_at <= vote.at and vote.at * 1_000 <= ahead_ms) or not (
        at_ms <= vote.not_after * 1_000 <= at_ms + VOTE_LIFETIME_S * 1_000
    ):
        return refused(IdpCode.VOTE_OUT_OF_TIME, f"signed after the ask and by now, for at most {VOTE_LIFETIME_S} s")
    # 6. This person may still say this, and it can still matter.
    if (wrong := _too_late(state.asked, vote, at_ms)) is not None:
        return refused(*wrong)
    # 7. Where the cell was not seen, the approver says to see it.
    if vote.answer == Answer.APPROVE and not ask.fresh and not vote.sees_clear:
        return refused(IdpCode.CLEAR_NOT_SEEN, "without fresh perception an approver attests to seeing the cell clear")
    cast = VoteRecord(vote.approver, Answer(vote.answer), vote.not_after, active=True, text=command.text)
    # 8. Of two people one votes with an operator key: what this vote would use up is left to its author ([PSK-9]).
    approvals = [each for each in (*state.asked.votes, cast) if each.answer is Answer.APPROVE and each.active]
    if vote.answer == Answer.APPROVE and len(approvals) >= ask.approvers and not state.asked.enough(approvals):
        return refused(IdpCode.OPERATOR_KEY_NEEDED, "of two people one votes with an operator key")
    after = replace(state.asked, votes=(*state.asked.votes, cast)).state(at_ms)
    return (VoteCast(ask.ask_id, len(state.asked.votes) + 1, cast, after, ask.trace_id),)


def _opened(rules: Rules, ask: AskRecord, command: CastVote, person: RegisteredPerson) -> Vote:
    """The vote, by a key or a passkey of the person's own.

    Raises:
        StatementError: as `vote.open` and `passkey_vote.open`.
    """
    if not passkey_vote.is_one(command.text):
        return votes.open(command.text, person.keys, rules.caps)
    party, (text, key) = relying_party(rules.issuer), command.read or ("", b"")
    if party is None or digest_of(text) != ask.digest:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "no passkey counts here, or the ask was not read")
    shown = asks.open(text, {key}, rules.caps)
    return passkey_vote.open(command.text, person.passkey_keys, ask=shown, party=party)[0]


def _too_late(asked: Asked, vote: Vote, at_ms: int) -> tuple[Code, str] | None:
    own = {cast.answer for cast in asked.votes if cast.approver == vote.approver}
    if vote.answer == Answer.WITHDRAW:
        # However the ask stands: taking back only ever takes away.
        if Answer.APPROVE not in own:
            return IdpCode.NOTHING_TO_WITHDRAW, "no approval by this person"
        return (IdpCode.VOTED_BEFORE, "withdrawn already") if Answer.WITHDRAW in own else None
    if own:
        return IdpCode.VOTED_BEFORE, "one answer of each person"
    match asked.state(at_ms):
        case AskState.DENIED | AskState.WITHDRAWN:
            return IdpCode.ASK_ANSWERED, "the ask has been ended"
        case AskState.EXPIRED:
            return IdpCode.ASK_OVER, "the ask is over"
        case AskState.GRANTED if vote.answer == Answer.APPROVE:
            return IdpCode.ASK_ANSWERED, "enough people approved"
        case AskState.GRANTED | AskState.OPEN:  # a denial ends even a granted ask
            return None


# --- openings ---------------------------------------------------------------------------------------------------------


def open_tier_4(rules: Rules, state: State, command: OpenTier4, at_ms: int) -> Outcome:
    """A person's leave to ask for one safety-critical act; nothing happens again for the very same text."""
    known = state.opening
    refused = Refusing(
        "opening", "" if known is None else known.opening_id, command.by, command.text, command.signed
    )  # fmt: skip
    # 1. The caller is an approver, now, and signed this opening itself.
    person = active_person(state, command.by, PersonRole.APPROVER)
    if person is None:
        return refused(IdpCode.NOT_PERMITTED, "approvers open")
    try:
        opening = openings.open(command.text, person.keys, rules.caps)
    except StatementError as error:
        return refused(
            whose(rules, state, command.text, error, kind=openings.KIND, not_yours=IdpCode.OPENING_NOT_YOURS),
            error.detail,
        )
    refused = Refusing("opening", opening.opening_id, command.by, command.text, command.signed)
    if opening.opener != person.id:
        return refused(IdpCode.OPENING_NOT_YOURS, "the opening names another person")
    # 2. An id means one text, for ever.
    digest = digest_of(command.text)
    if known is not None:
        return () if known.digest == digest else refused(IdpCode.OPENING_DIFFERS, "another opening has this id")
    # 3. Its times are sane.
    lasts_s = opening.not_after - opening.not_before
    if not at_ms < opening.not_after * 1_000 <= at_ms + OPENING_LIFETIME_S * 1_000 or not lasts_s <= OPENING_LIFETIME_S:
        return refused(IdpCode.OPENING_OUT_OF_TIME, f"not over, and for at most {OPENING_LIFETIME_S} s")
    # 4. It can match something: a slip would open nothing and seem to.
    match state.parties.get(opening.agent):
        case RegisteredAgent(standing=Standing.REVOKED):
            return refused(IdpCode.AGENT_INACTIVE, "the agent is revoked")
        case RegisteredAgent():
            pass
        case _:
            return refused(IdpCode.NOT_FOUND, "no such agent")
    if opening.audience not in state.served:
        return refused(IdpCode.NOT_FOUND, "no enforcement point serves this audience")
    # 5. All of them fit one answer to the enforcement point.
    if not sum(1 for other in state.openings if not other.over(at_ms)) < OPENINGS:
        return refused(IdpCode.TOO_MANY_OPENINGS, f"{OPENINGS} openings of this audience are in force")
    return (OpeningMade(_opening_record(opening, digest, command.text)),)


def _opening_record(opening: Opening, digest: str, text: str) -> OpeningRecord:
    return OpeningRecord(
        opening_id=opening.opening_id,
        digest=digest,
        opener=opening.opener,
        audience=opening.audience,
        agent=opening.agent,
        object=opening.object,
        operation=opening.operation,
        not_before=opening.not_before,
        not_after=opening.not_after,
        closed=False,
        text=text,
    )


def close_opening(state: State, command: CloseOpening) -> Outcome:
    """Closes an opening for any approver, not only its opener: closing only takes away.

    A second closing has no effect.
    """
    refused = Refusing("closing", command.opening_id, command.by, "", None)
    if active_person(state, command.by, PersonRole.APPROVER) is None:
        return refused(IdpCode.NOT_PERMITTED, "approvers close")
    if state.opening is None:
        return refused(IdpCode.OPENING_UNKNOWN, "no such opening")
    if state.opening.closed:
        return ()
    return (OpeningClosed(state.opening.opening_id, command.reason),)

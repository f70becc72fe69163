"""Mandates: a sponsor signs once, and for days the agent draws short tokens, attested anew, with nobody asked.

All that would stop the sponsor from issuing a token now stops a draw, too. Clause [STM-16] in docs/spec.md.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import thumbprint
from capabilities.statements.people import mandate as mandate_statement
from capabilities.statements.people.vote import digest_of
from capabilities.statements.statement_form import signer_thumbprint
from capabilities.token import hop_rules
from capabilities.values.algebra import meet
from capabilities.values.chain import Sponsor
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.scope import Scope
from policies.words.reason_table import Reason
from ztpm_idp.domain import conduct
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import MandateSigned, RevocationKind
from ztpm_idp.domain.lending import allowances, issuance
from ztpm_idp.domain.lending.attestation import judge, may_receive
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent
from ztpm_idp.domain.registry import active_person
from ztpm_idp.domain.state import MandateRecord

if TYPE_CHECKING:
    from capabilities.statements.people.mandate import Mandate
    from capabilities.values.chain import EvidenceKind
    from ztpm_idp.domain.commands import DrawToken, SignMandate
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

LIVE_TOKENS: Final = 2
"""Most tokens of one mandate that are live at once: the one that is used, and the next one."""
MANDATES_OF_ONE: Final = 16
"""Most mandates of one agent that may be in force."""
KEY_EVIDENCE_S: Final = 86_400
"""Seconds after the signature for which evidence of kind `key` draws: nobody vouches for its software meanwhile."""
METHOD: Final = "operator-key"
"""Way in which the sponsor was authenticated: the signature under the mandate."""


class MandateState(StrEnum):
    """Standing of a mandate, as people are told it."""

    IN_FORCE = "in force"
    SUSPENDED = "suspended"
    """Its agent is: nothing is drawn until a person restores it."""
    REVOKED = "revoked"
    ENDED = "ended"
    """Its sponsor or its agent has ended."""
    OVER = "over"


def sign(rules: Rules, state: State, command: SignMandate, at_ms: int) -> Outcome:
    """The sponsor's mandate, in force from now on; nothing happens again for the very same text."""
    # 1. The caller is a sponsor, now, and signed this mandate with a key of its own.
    person = active_person(state, command.by, PersonRole.SPONSOR)
    if person is None:
        return Refusal(IdpCode.NOT_PERMITTED, "a sponsor signs mandates")
    try:
        promised = mandate_statement.open(command.text, person.keys, rules.caps)
    except StatementError as error:
        return Refusal(error.code, error.detail)
    if promised.sponsor != person.id:
        return Refusal(IdpCode.MANDATE_NOT_YOURS, "the mandate names another sponsor")
    if promised.issuer != rules.issuer:
        return Refusal(FaultCode.STATEMENT_UNTRUSTED, "the mandate is for another issuer")
    # 2. An id means one text, for ever.
    if state.mandate is not None:
        same = state.mandate.digest == digest_of(command.text)
        return () if same else Refusal(IdpCode.MANDATE_DIFFERS, "another mandate has this id")
    # 3. It was signed just now: `authenticated_at` of each drawn token is the time that it states.
    age_ms = at_ms - promised.at * 1_000
    if not -rules.caps.skew_s * 1_000 <= age_ms <= rules.caps.proof_age_s * 1_000:
        return Refusal(IdpCode.MANDATE_OUT_OF_TIME, f"signed within the last {rules.caps.proof_age_s} s")
    if not at_ms < promised.scope.not_after * 1_000:
        return Refusal(IdpCode.MANDATE_OVER, "it would be over before it begins")
    # 4. The agent may receive authority, has this key, and is not contracted.
    agent = may_receive(state, promised.agent)
    if isinstance(agent, Refusal):
        return agent
    if agent.thumbprint != promised.agent_key:
        return Refusal(IdpCode.MANDATE_NOT_YOURS, "the agent's key is another")
    if (less := contracted(rules, state, agent.id, at_ms)) is not None:
        return less
    # 5. They are few enough to be looked through.
    living = sum(1 for other in state.mandates if other.agent == agent.id and at_ms < other.not_after * 1_000)
    if living >= MANDATES_OF_ONE:
        return Refusal(IdpCode.TOO_MANY_MANDATES, f"at most {MANDATES_OF_ONE} of one agent are in force")
    if (spent := allowances.spent(rules, person.id, state.used, "mandates")) is not None:
        return spent
    return (MandateSigned(_record(promised, command.text), command.signed),)


def draw(rules: Rules, state: State, command: DrawToken, at_ms: int) -> Outcome:
    """A new token's authority block, as much of the mandate as its sponsor could sign at this moment."""
    # 1. The mandate is the caller's, in force, and its sponsor stands by it.
    found = drawable(rules, state, command.by, at_ms)
    if isinstance(found, Refusal):
        return found
    agent, promised = found
    # 2. At most so many are live: a stolen key keeps no store of tokens.
    live = [token for token in state.drawn if token.live(at_ms)]
    if len(live) >= LIVE_TOKENS:
        until = min(token.not_after for token in live)
        return Refusal(IdpCode.MANDATE_TOKENS_LIVE, f"at most {LIVE_TOKENS} at once; one ends at {until}")
    if (spent := allowances.of_token(rules, state, promised.sponsor)) is not None:
        return spent
    # 3. The agent shows itself anew, for this sponsor and this request.
    shown = judge(
        rules, state, agent, command.evidence,
        delegator=promised.sponsor, request_digest=command.request_digest, purpose=command.hop_id, at_ms=at_ms,
    )  # fmt: skip
    if isinstance(shown, Refusal):
        return shown
    if not shown.kind.vouched and not at_ms <= (promised.at + KEY_EVIDENCE_S) * 1_000:
        return Refusal(IdpCode.MANDATE_NEEDS_PLATFORM, f"evidence of kind {shown.kind} draws for {KEY_EVIDENCE_S} s")
    # 4. No more than the sponsor promised, and no more than the sponsor could sign now.
    at = at_ms // 1_000
    longest_s = min(command.lifetime_s, rules.token_lifetime_s, hop_rules.longest_s(shown.kind, rules.caps))
    today = could_sign(rules, state, promised.scope, kind=shown.kind, at=at, not_after=at + longest_s)
    if today is None or (scope := meet(promised.scope, today)) is None:
        return Refusal(IdpCode.MANDATE_LEAVES_NOTHING, "no audience or time is left of it")
    # 5. The very checks that verifiers make.
    lent = issuance.Lent(
        purpose=promised.purpose,
        scope=scope,
        request_digest=command.request_digest,
        evidence=command.evidence,
        token_id=command.token_id,
        hop_id=command.hop_id,
        signed=command.signed,
        mandate_id=promised.mandate_id,
    )
    # The sponsor was there when the mandate was signed, and has not been since.
    sponsor = Sponsor(rules.issuer, promised.sponsor, METHOD, promised.at)
    return issuance.first_block(rules, lent, sponsor, agent, shown, at_ms=at_ms)


def standing(state: State, mandate: MandateRecord, at_ms: int) -> MandateState:
    """Standing of a mandate whose parties the state holds, at this wall-clock time."""
    if mandate.revoked:
        return MandateState.REVOKED
    if not at_ms < mandate.not_after * 1_000:
        return MandateState.OVER
    person = active_person(state, mandate.sponsor, PersonRole.SPONSOR)
    match may_receive(state, mandate.agent):
        case RegisteredAgent() if person is not None and mandate.key in map(thumbprint, person.keys):
            return MandateState.IN_FORCE
        case Refusal(code=IdpCode.AGENT_SUSPENDED | IdpCode.AGENT_HELD):
            return MandateState.SUSPENDED
        case _:
            return MandateState.ENDED


def drawable(rules: Rules, state: State, by: str, at_ms: int) -> tuple[RegisteredAgent, Mandate] | Refusal:
    """The agent `by` and the wanted mandate, when it may draw from it now."""
    agent, mandate = may_receive(state, by), state.mandate
    if not isinstance(state.parties.get(by), RegisteredAgent):
        return Refusal(IdpCode.NOT_PERMITTED, "agents draw tokens")
    if mandate is None:
        return Refusal(IdpCode.MANDATE_UNKNOWN, "no such mandate")
    if mandate.agent != by:
        return Refusal(IdpCode.MANDATE_NOT_YOURS, "the mandate is another agent's")
    if isinstance(agent, Refusal):
        return agent
    if mandate.revoked or (RevocationKind.MANDATE.value, mandate.mandate_id) in state.revoked:
        return Refusal(IdpCode.MANDATE_REVOKED, "the mandate is revoked, for ever")
    if not at_ms < mandate.not_after * 1_000:
        return Refusal(IdpCode.MANDATE_OVER, "the mandate is over")
    person = active_person(state, mandate.sponsor, PersonRole.SPONSOR)
    if person is None:
        return Refusal(IdpCode.SPONSOR_INACTIVE, "the mandate's sponsor is not active")
    # Opened again: of a person's keys, each may have ended since.
    try:
        promised = mandate_statement.open(mandate.text, person.keys, rules.caps)
    except StatementError as error:
        return Refusal(error.code, "the key that signed the mandate is its sponsor's no longer")
    if thumbprint(agent.key) != promised.agent_key:
        return Refusal(IdpCode.MANDATE_NOT_YOURS, "the mandate is for another key")
    if not at_ms >= promised.scope.not_before * 1_000:
        return Refusal(FaultCode.NOT_YET_VALID, "the mandate begins later")
    return contracted(rules, state, agent.id, at_ms) or (agent, promised)


def could_sign(
    rules: Rules, state: State, promised: Scope, *, kind: EvidenceKind, at: int, not_after: int
) -> Scope | None:
    """The widest scope over these grants that the sponsor could sign at `at`; None where no audience is alive."""
    dead = {name for of, name in state.revoked if of == RevocationKind.AUDIENCE.value}
    audiences = promised.audiences - dead
    if not audiences:
        return None
    return Scope(
        grants=promised.grants,
        ceiling=hop_rules.highest(kind, rules.caps),
        audiences=audiences,
        delegates=promised.delegates,
        depth=promised.depth,
        # Verifiers take no skew at the ends of a window.
        not_before=at - rules.caps.skew_s,
        not_after=not_after,
    )


def contracted(rules: Rules, state: State, agent: str, at_ms: int) -> Refusal | None:
    """Refusal of an agent whose behaviour contracted its scope; the state holds its conduct."""
    known = conduct.of(state, agent)
    told = conduct.published(agent, known, at=at_ms // 1_000, parameters=rules.policies.parameters)
    if not told.reading.contracted:
        return None
    return Refusal(Reason.SCOPE_CONTRACTED, "a person restores the agent first, and then signs a new mandate")


def _record(promised: Mandate, text: str) -> MandateRecord:
    return MandateRecord(
        mandate_id=promised.mandate_id,
        digest=digest_of(text),
        sponsor=promised.sponsor,
        agent=promised.agent,
        key=signer_thumbprint(text),
        signed_at=promised.at,
        not_after=promised.scope.not_after,
        text=text,
    )

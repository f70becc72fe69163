"""Lending authority: by a person to an agent, and by a holder to the next agent.

The result is the content of the token's block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capabilities.statements.revocation import RevocationView
from capabilities.token import block, hop_rules
from capabilities.token.delegate import next_leaf
from capabilities.values.chain import Attestation, Chain, HopGrant, Sponsor
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from capabilities.values.explanation import explain
from capabilities.values.scope import Tier
from policies.words.reason_table import Reason
from ztpm_idp.domain import conduct
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import DelegationRefused, RevocationKind, TokenDelegated, TokenIssued
from ztpm_idp.domain.lending import allowances, delegation_policy
from ztpm_idp.domain.lending.attestation import held, judge, may_receive
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent
from ztpm_idp.domain.refusals import BODY_BYTES, WIDENINGS
from ztpm_idp.domain.registry import active_person

if TYPE_CHECKING:
    from capabilities.values.chain import EvidenceKind
    from capabilities.values.scope import Scope
    from policies.evidence.model import Decision
    from ztpm_idp.domain.codes import Code
    from ztpm_idp.domain.commands import Delegate, Issue
    from ztpm_idp.domain.events import Event, SignedRequest
    from ztpm_idp.domain.lending.attestation import AcceptedEvidence
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State


OPERATOR_KEY: Final = "operator-key"
"""Method of a sponsor who signed the request itself."""
SESSION_KEY_CEILING: Final = Tier(3)
"""Highest tier that a session-bound key lends: a safety-critical act starts at a person's own key."""


def issue(rules: Rules, state: State, command: Issue, at_ms: int) -> Outcome:
    """A new token's authority block, when a sponsor lends to an agent that is attested for exactly this."""
    # 1. The caller is a sponsor, now.
    if active_person(state, command.by, PersonRole.SPONSOR) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "a sponsor issues tokens")
    if (spent := allowances.of_token(rules, state, command.by)) is not None:
        return spent
    # 2. The agent may receive authority, and shows it for this sponsor and this request.
    agent = may_receive(state, command.agent)
    if isinstance(agent, Refusal):
        return agent
    shown = judge(
        rules, state, agent, command.evidence,
        delegator=command.by, request_digest=command.request_digest, purpose=command.hop_id, at_ms=at_ms,
    )  # fmt: skip
    if isinstance(shown, Refusal):
        return shown
    # 3. The scope keeps the profile's rules and what this kind of evidence can carry.
    # A request signed with an operator key is an authentication of this instant; a session-bound key was confirmed in
    # a session, and its person was there when that session's login was made.
    bound = state.session_key
    method, authenticated_ms = (OPERATOR_KEY, at_ms) if bound is None else (bound.how.method.value, bound.how.at_ms)
    sponsor = Sponsor(
        issuer=rules.issuer, subject=command.by, method=method, authenticated_at=authenticated_ms // 1_000
    )
    if bound is not None and command.scope.ceiling > SESSION_KEY_CEILING:
        return Refusal(FaultCode.ABOVE_CEILING, f"a session-bound key lends at most tier {int(SESSION_KEY_CEILING)}")
    lent = Lent(
        purpose=command.purpose,
        scope=command.scope,
        request_digest=command.request_digest,
        evidence=command.evidence,
        token_id=command.token_id,
        hop_id=command.hop_id,
        signed=command.signed,
    )
    return first_block(rules, lent, sponsor, agent, shown, at_ms=at_ms)


@dataclass(frozen=True, slots=True)
class Lent:
    """Content of a token to be: fields as in `Issue`, with the mandate that it is drawn from, if any."""

    purpose: str
    scope: Scope
    request_digest: bytes
    evidence: str
    token_id: str
    hop_id: str
    signed: SignedRequest
    mandate_id: str | None = None


def first_block(
    rules: Rules, lent: Lent, sponsor: Sponsor, agent: RegisteredAgent, shown: AcceptedEvidence, *, at_ms: int
) -> Outcome:
    """The authority block of a token and the nonce that it spends; refused as `issued` refuses."""
    made = issued(rules, lent, sponsor, agent, shown.kind, at_ms=at_ms)
    return made if isinstance(made, Refusal) else (shown.spent, made)


def issued(
    rules: Rules, lent: Lent, sponsor: Sponsor, agent: RegisteredAgent, kind: EvidenceKind, *, at_ms: int
) -> TokenIssued | Refusal:
    """The authority block of a token, when it passes the very checks that verifiers make."""
    hop = _hop(lent, agent, kind, delegator=sponsor.subject, sponsor=sponsor.subject, at_ms=at_ms)
    authority = block.AuthorityBlock(lent.token_id, sponsor, 0, hop, lent.scope, lent.mandate_id)
    highest = hop_rules.highest(kind, rules.caps)
    if lent.scope.ceiling > highest:
        return Refusal(FaultCode.ABOVE_CEILING, f"evidence of kind {kind} carries at most tier {int(highest)}")
    try:
        block.well_formed(authority, rules.caps)
        first = hop_rules.first_hop(authority, reserved=rules.own_keys, caps=rules.caps)
        hop_rules.check_lifetimes((first,), rules.caps)
    except CapabilityError as error:
        return Refusal(error.code, error.detail)
    if (over := _over(rules, lent.scope, at_ms)) is not None:
        return over
    return TokenIssued(lent.token_id, sponsor, hop, lent.scope, lent.evidence, lent.signed, lent.mandate_id)


def delegate(rules: Rules, state: State, command: Delegate, at_ms: int) -> Outcome:
    """Appends one hop, when the holder delegates strictly less than it has to an agent attested for exactly this."""
    # 1. The token verifies in full against the revocations of this very transaction.
    verified = _verified(rules, state, command, at_ms)
    if isinstance(verified, Refusal):
        return verified
    chain, audience = verified
    refused = _Refusing(rules, state, command, chain, at_ms)
    # 2. The caller proved possession of the leaf's key.
    if command.key != chain.leaf.key or command.by != chain.leaf.agent:
        return Refusal(FaultCode.PROOF_WRONG_KEY, "the proof is not by the holder of the token")
    for holder in (state.parties.get(one.agent) for one in chain.hops):
        if isinstance(holder, RegisteredAgent) and holder.held:
            return held(holder.id)
    if (spent := allowances.spent(rules, chain.sponsor.subject, state.used, "delegations")) is not None:
        return spent
    # 3. The agent may receive authority, and is new to the chain.
    agent = may_receive(state, command.delegate)
    if isinstance(agent, Refusal):
        return refused(agent)
    if any(hop.agent == agent.id or hop.key == agent.key for hop in chain.hops):
        return refused(Refusal(FaultCode.DELEGATE_NOT_ALLOWED, "no agent stands twice in a chain"))
    # 4. The delegate shows itself for this delegator and this request.
    shown = judge(
        rules, state, agent, command.evidence,
        delegator=chain.leaf.agent, request_digest=command.request_digest, purpose=command.hop_id, at_ms=at_ms,
    )  # fmt: skip
    if isinstance(shown, Refusal):
        return refused(shown)
    # 5. The token names this delegate and has depth left, and what is lent is strictly less than what is held: the very
    # checks that verifiers make.
    hop = _hop(command, agent, shown.kind, delegator=chain.leaf.agent, sponsor=chain.sponsor.subject, at_ms=at_ms)
    try:
        leaf = next_leaf(chain, hop, command.restriction, trust=rules.trust, caps=rules.caps, reserved=rules.own_keys)
    except CapabilityError as error:
        return refused(_told(error, chain, command))
    if (over := _over(rules, leaf.scope, at_ms)) is not None:
        return refused(over)
    # 6. The policies permit it.
    decision, against = delegation_policy.judged(rules, state, command, chain, audience=audience, at_ms=at_ms)
    if against is not None:
        return refused(against, decision)
    made = TokenDelegated(chain, hop, command.restriction, leaf.scope, command.evidence, command.signed)
    return (shown.spent, made, *_observed(rules, state, chain, command.hop_id, at_ms=at_ms))


def _verified(rules: Rules, state: State, command: Delegate, at_ms: int) -> tuple[Chain, str] | Refusal:
    """The holder's chain, and an audience that it is good for."""
    verifier, audience = rules.verifier, ""
    view = RevocationView(epoch=state.epoch, age_ms=0, revoked=state.revoked)
    found: Chain | Fault
    match verifier.audiences(command.token, view=view):
        case Fault() as fault:
            found = fault
        case named:
            # The provider serves no audience of its own: the token must be good for at least one of those it names.
            alive = [one for one in sorted(named) if (RevocationKind.AUDIENCE.value, one) not in state.revoked]
            audience = (alive or sorted(named))[0]
            found = verifier.verify(command.token, at=at_ms / 1_000, audience=audience, view=view, lease_ms=0)
    match found:
        case Chain():
            return found, audience
        case Fault(code=code, detail=detail):
            return Refusal(code, detail)


def _over(rules: Rules, scope: Scope, at_ms: int) -> Refusal | None:
    if not at_ms < scope.not_after * 1_000:
        return Refusal(FaultCode.EXPIRED, "it would be over before it begins")
    if scope.not_after - at_ms // 1_000 > rules.token_lifetime_s:
        return Refusal(FaultCode.LIFETIME_TOO_LONG, f"at most {rules.token_lifetime_s} s")
    return None


def _hop(
    command: Lent | Delegate, agent: RegisteredAgent, kind: EvidenceKind, *, delegator: str, sponsor: str, at_ms: int
) -> HopGrant:
    return HopGrant(
        hop_id=command.hop_id,
        agent=agent.id,
        key=agent.key,
        delegator=delegator,
        purpose=command.purpose,
        request_digest=command.request_digest,
        attestation=Attestation(kind, agent.software_digest, at_ms // 1_000),
        # A role is vouched for among the sponsor's own agents only.
        role=agent.role if agent.sponsor == sponsor else "",
    )


def _told(error: CapabilityError, chain: Chain, command: Delegate) -> Refusal:
    """Refusal of a hop; where it is not narrower, with the places and their nearest values."""
    if error.code is FaultCode.NOT_NARROWER and (why := explain(chain.scope, command.restriction)) is not None:
        return Refusal(error.code, why.sentence, explanation=why)
    return Refusal(error.code, error.detail)


@dataclass(frozen=True, slots=True)
class _Refusing:
    """Maker of refusals of a holder's attempt, with its record for the ledger and its effect on conduct."""

    rules: Rules
    state: State
    command: Delegate
    chain: Chain
    at_ms: int

    def __call__(self, refusal: Refusal, decision: Decision | None = None) -> Refusal:
        signed = self.command.signed
        attempt = DelegationRefused(
            token_id=self.chain.token_id,
            parent_hop=self.chain.leaf.hop_id,
            holder=self.chain.leaf.agent,
            delegate=self.command.delegate,
            code=refusal.code.value,
            widenings=() if refusal.explanation is None else refusal.explanation.widenings[:WIDENINGS],
            signed=signed if len(signed.body) <= BODY_BYTES else replace(signed, body=""),
            decision=decision,
        )
        # Who asked for nothing less did not ask for more: that is a slip.
        slip = refusal.explanation is not None and not refusal.explanation.widenings
        code = Reason.PARAMETERS_WRONG if slip else refusal.code
        return replace(refusal, recorded=(attempt, *self._observed(code)), charge=self._observed(Reason.NOT_GRANTED))

    def _observed(self, code: Code) -> tuple[Event, ...]:
        return _observed(self.rules, self.state, self.chain, self.command.hop_id, at_ms=self.at_ms, refused=code)


def _observed(
    rules: Rules, state: State, chain: Chain, hop_id: str, *, at_ms: int, refused: Code | None = None
) -> tuple[Event, ...]:
    """Conduct of the holder after the attempt, whose possession was proven."""
    report = conduct.of_delegation(rules, chain, hop_id, at_ms=at_ms, refused=refused)
    return () if report is None else conduct.observed(rules, state, (report,), at_ms)

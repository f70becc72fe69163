"""Access tokens: from a person's assent, from a mandate, by exchange; and the end of each.

Each has a capability of ours behind it, in whose last hop its `jti` is the hop id. A client's hop has evidence of kind
`client`, so no verifier takes more than tier 1 or ten minutes from it. Nobody has the key of such a hop.
"""

from __future__ import annotations

import hmac
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import thumbprint
from capabilities.token import hop_rules
from capabilities.values.algebra import meet
from capabilities.values.chain import EvidenceKind, Sponsor
from capabilities.values.scope import Scope
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import RevocationKind, Revoked, TokenDelegated
from ztpm_idp.domain.lending import allowances, issuance
from ztpm_idp.domain.lending.attestation import may_receive
from ztpm_idp.domain.lending.mandates import METHOD, contracted, could_sign, drawable
from ztpm_idp.domain.oauth.events import (
    AccessMade,
    AssentGiven,
    CodeSpent,
    FamilyEnded,
    RefreshMade,
    RefreshSpent,
)
from ztpm_idp.domain.oauth.records import AccessRecord, CodeRecord, FamilyRecord, TemplateRecord
from ztpm_idp.domain.oauth.registering import HIGHEST, ROLE, TEMPLATES_AT_ONCE, agent_of, limits_of, united, written
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.domain.registry import AGENTS_OF_ONE, active_person, full, new_party

if TYPE_CHECKING:
    from capabilities.values.scope import Grant, Tier
    from ztpm_idp.domain.commands import Delegate
    from ztpm_idp.domain.events import Event, TokenIssued
    from ztpm_idp.domain.oauth.commands import (
        Assent,
        DrawAccess,
        EndAccess,
        EndFamily,
        Minting,
        RedeemCode,
        Refresh,
    )
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

CODE_MS: Final = 60_000
"""Life of an authorization code: RFC 6749 section 4.1.2 allows ten minutes; a redirect takes seconds."""
FAMILY_S: Final = 7 * 86_400
"""Longest life of what one assent leads to: that of a mandate."""
CLIENT_TOKENS: Final = 8
"""Most access tokens of one mandate that are live at once: each instance of a client asks for its own."""
REUSED: Final = "a spent code or refresh token was used again"


def assent(rules: Rules, state: State, command: Assent, at_ms: int) -> Outcome:
    """The person's assent, and the agent that stands for a client which nobody registered."""
    if active_person(state, command.by, PersonRole.SPONSOR) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "a sponsor lends to clients")
    chosen = [one for one in state.oauth.templates if one.name in command.templates]
    if not chosen or {one.name for one in chosen} != command.templates or len(chosen) > TEMPLATES_AT_ONCE:
        return Refusal(IdpCode.SCOPE_UNKNOWN, "no such scope, or none")
    if any(one.audience != command.resource for one in chosen):
        return Refusal(IdpCode.TARGET_REFUSED, "the scope is for another resource")
    limits = united(chosen)
    if isinstance(limits, Refusal):
        return limits
    registered = state.parties.get(command.agent)
    made: tuple[Event, ...] = ()
    if registered is None and state.oauth.client is None:
        if not state.crowd < AGENTS_OF_ONE:
            return full(f"{AGENTS_OF_ONE} agents of one sponsor")
        if (spent := allowances.of_agent(rules, state, command.by)) is not None:
            return spent
        new = agent_of(
            command.agent, command.agent_key, sponsor=command.by, model=command.client_name, software=command.document
        )
        outcome = new_party(rules, state, new)
        if isinstance(outcome, Refusal):
            return outcome
        made = outcome
    else:
        agent = may_receive(state, command.agent)
        if isinstance(agent, Refusal):
            return agent
        # The id of an unregistered client's agent can be foreseen: one that another person made does not stand for it.
        if agent.role != ROLE or (state.oauth.client is None and agent.sponsor != command.by):
            return Refusal(IdpCode.CLIENT_UNKNOWN, "the agent of this id stands for no client of the person")
    family = FamilyRecord(
        family=command.family,
        client_id=command.client_id,
        agent=command.agent,
        sponsor=command.by,
        method=command.method,
        authenticated_at=command.authenticated_at,
        resource=command.resource,
        scope=" ".join(sorted(command.templates)),
        limits=written(*limits),
        jkt=command.jkt,
        not_after=at_ms // 1_000 + FAMILY_S,
    )
    return (*made, AssentGiven(CodeRecord(command.code, family, command.redirect, command.challenge, at_ms)))


def redeem(rules: Rules, state: State, command: RedeemCode, at_ms: int) -> Outcome:
    """The first tokens of a family; a code that is used twice ends all that it led to."""
    code = state.oauth.code
    # 1. The code is this client's. Another client learns nothing, and ends nothing.
    if code is None or code.family.client_id != command.client_id or code.family.agent != command.by:
        return Refusal(IdpCode.CODE_REFUSED, "no such code of this client")
    # 2. Once.
    if code.spent:
        return ended(state, code.family, REUSED)
    # 3. In time, for the same redirect URI, by whoever began: PKCE, and the DPoP key where one was named.
    if not 0 <= at_ms - code.given_ms <= CODE_MS:
        return Refusal(IdpCode.CODE_REFUSED, "the code is over")
    if command.redirect != code.redirect:
        return Refusal(IdpCode.CODE_REFUSED, "the code was given to another redirect URI")
    if not hmac.compare_digest(command.challenge, code.challenge):
        return Refusal(IdpCode.CODE_REFUSED, "the verifier is not that of the challenge")
    if code.family.jkt not in {None, command.minting.jkt}:
        return Refusal(IdpCode.CODE_REFUSED, "the code is bound to another DPoP key")
    if command.resource not in {None, code.family.resource}:
        return Refusal(IdpCode.TARGET_REFUSED, "the code is for another resource")
    made = _of_family(rules, state, code.family, command.minting, sponsor=command.sponsor, at_ms=at_ms)
    if isinstance(made, Refusal):
        return made
    spent = CodeSpent(code.digest, code.family.family, command.minting.jkt)
    return (spent, RefreshMade(command.refresh, code.family.family), *made)


def refresh(rules: Rules, state: State, command: Refresh, at_ms: int) -> Outcome:
    """The next tokens of a family; a refresh token that is used twice ends all of it."""
    found = state.oauth.refresh
    if found is None or found.family.client_id != command.client_id or found.family.agent != command.by:
        return Refusal(IdpCode.REFRESH_REFUSED, "no such refresh token of this client")
    family = found.family
    if family.jkt != command.minting.jkt:
        return Refusal(IdpCode.REFRESH_REFUSED, "the refresh token is bound to another DPoP key, or to none")
    if found.spent:
        return ended(state, family, REUSED)
    if command.scope not in {None, family.scope}:
        return Refusal(IdpCode.SCOPE_UNFIT, "exactly the scope that the person chose")
    if command.resource not in {None, family.resource}:
        return Refusal(IdpCode.TARGET_REFUSED, "the refresh token is for another resource")
    made = _of_family(rules, state, family, command.minting, sponsor=command.sponsor, at_ms=at_ms)
    if isinstance(made, Refusal):
        return made
    return (RefreshSpent(found.digest), RefreshMade(command.refresh, family.family), *made)


def draw(rules: Rules, state: State, command: DrawAccess, at_ms: int) -> Outcome:
    """An access token from a mandate that names this client's agent: no more than its sponsor could sign now."""
    client = state.oauth.client
    if client is None or client.client_id != command.client_id or client.key is None:
        return Refusal(IdpCode.CLIENT_UNKNOWN, "a registered client with a key draws")
    found = drawable(rules, state, command.by, at_ms)
    if isinstance(found, Refusal):
        return found
    agent, promised = found
    live = [token for token in state.drawn if token.live(at_ms)]
    if len(live) >= CLIENT_TOKENS:
        return Refusal(IdpCode.MANDATE_TOKENS_LIVE, f"at most {CLIENT_TOKENS} at once")
    if (spent := allowances.of_token(rules, state, promised.sponsor)) is not None:
        return spent
    if command.resource not in promised.scope.audiences:
        return Refusal(IdpCode.TARGET_REFUSED, "the mandate is for other resources")
    kind, at = EvidenceKind.CLIENT, at_ms // 1_000
    longest_s = min(rules.token_lifetime_s, hop_rules.longest_s(kind, rules.caps))
    today = could_sign(rules, state, promised.scope, kind=kind, at=at, not_after=at + longest_s)
    scope = None if today is None else meet(promised.scope, today)
    if scope is None:
        return Refusal(IdpCode.MANDATE_LEAVES_NOTHING, "no audience or time is left of it")
    limits, chosen = (scope.grants, scope.ceiling), list[TemplateRecord]()
    if command.scope:
        chosen = [one for one in state.oauth.templates if one.name in command.scope]
        if {one.name for one in chosen} != set(command.scope):
            return Refusal(IdpCode.SCOPE_UNKNOWN, "no such scope")
        chosen = [one for one in chosen if one.audience == command.resource]
        if not chosen:
            return Refusal(IdpCode.TARGET_REFUSED, "the scope is for another resource")
        narrower = united(chosen)
        if isinstance(narrower, Refusal):
            return narrower
        limits = narrower
    asked = _scope(limits[0], limits[1], command.resource, scope.not_before, scope.not_after)
    held = meet(asked, _scope(scope.grants, scope.ceiling, command.resource, scope.not_before, scope.not_after))
    if held is None or (command.scope and len(held.grants) != len(asked.grants)):
        return Refusal(IdpCode.SCOPE_UNFIT, "the mandate does not hold all of this scope")
    sponsor = Sponsor(rules.issuer, promised.sponsor, METHOD, promised.at)
    purpose = f"{promised.purpose} (OAuth client {command.client_id})"
    lent = _lent(command.minting, held, purpose=purpose, mandate_id=promised.mandate_id)
    made = issuance.issued(rules, lent, sponsor, agent, kind, at_ms=at_ms)
    if isinstance(made, Refusal):
        return made
    return (
        made,
        _access(
            made,
            command.minting,
            client_id=command.client_id,
            resource=command.resource,
            scope=" ".join(sorted(one.name for one in chosen)),
            family=None,
        ),
    )


def exchanged(rules: Rules, state: State, command: Delegate, at_ms: int) -> Outcome:
    """The hop that a holder adds, and the access token of the delegate, bound to the delegate's own key."""
    outcome = issuance.delegate(rules, state, command, at_ms)
    if isinstance(outcome, Refusal) or command.resource is None:
        return outcome
    for event in outcome:
        if isinstance(event, TokenDelegated):
            if event.scope.audiences != {command.resource}:
                return Refusal(IdpCode.TARGET_REFUSED, "an access token serves one audience: restrict to it")
            if event.scope.ceiling > HIGHEST:
                return Refusal(IdpCode.SCOPE_UNFIT, f"an access token carries at most tier {int(HIGHEST)}")
            return (*outcome, AccessMade(_of_hop(event, command.resource)))
    raise AssertionError


def end_access(state: State, command: EndAccess) -> Outcome:
    """The access token, or the family of the refresh token, is over; nothing happens where it is not this client's."""
    family = None if state.oauth.refresh is None else state.oauth.refresh.family
    if command.refresh is not None and family is not None and family.client_id == command.client_id:
        return ended(state, family, "the client gave it back")
    access = state.oauth.access
    if command.jti is None or access is None or access.client_id != command.client_id:
        return ()
    return _revoked(access, "the client gave it back")


def end_family(state: State, command: EndFamily) -> Outcome:
    """The person who lent, or an administrator, takes it back, with every access token of it."""
    family = state.oauth.family
    administrator = active_person(state, command.by, PersonRole.ADMIN)
    if family is None or (family.sponsor != command.by and administrator is None):
        return Refusal(IdpCode.FAMILY_UNKNOWN, "nothing that the caller lent to a client has this id")
    return ended(state, family, command.reason)


def ended(state: State, family: FamilyRecord, reason: str) -> tuple[Event, ...]:
    """The end of a family, with each access token that may be live; nothing where it had ended before."""
    first = () if family.ended else (FamilyEnded(family.family, family.client_id, family.sponsor, reason),)
    return (*first, *(event for access in state.oauth.live for event in _revoked(access, reason)))


def _revoked(access: AccessRecord, reason: str) -> tuple[Revoked, ...]:
    # What was exchanged has other holders above: its own hop ends, and nothing else.
    if len(access.actors) > 1:
        return (Revoked(RevocationKind.HOP, access.jti, reason, None),)
    return (Revoked(RevocationKind.TOKEN, access.token_id, reason, None),)


def _of_family(
    rules: Rules, state: State, family: FamilyRecord, minting: Minting, *, sponsor: str, at_ms: int
) -> tuple[Event, ...] | Refusal:
    if family.ended or not at_ms < family.not_after * 1_000:
        return Refusal(IdpCode.FAMILY_OVER, "the person took it back, or its time is over")
    if sponsor != family.sponsor or active_person(state, family.sponsor, PersonRole.SPONSOR) is None:
        return Refusal(IdpCode.SPONSOR_INACTIVE, "the person who lent is no active sponsor")
    if (spent := allowances.of_token(rules, state, sponsor)) is not None:
        return spent
    agent = may_receive(state, family.agent)
    if isinstance(agent, Refusal):
        return agent
    if (less := contracted(rules, state, agent.id, at_ms)) is not None:
        return less
    limits = limits_of(family.limits)
    if isinstance(limits, Refusal):
        return limits
    at = at_ms // 1_000
    longest_s = min(rules.token_lifetime_s, hop_rules.longest_s(EvidenceKind.CLIENT, rules.caps))
    until = min(at + longest_s, family.not_after)
    scope = _scope(*limits, family.resource, at - rules.caps.skew_s, until)
    who = Sponsor(rules.issuer, family.sponsor, family.method, family.authenticated_at)
    lent = _lent(minting, scope, purpose=f"OAuth client {family.client_id}", mandate_id=None)
    made = issuance.issued(rules, lent, who, agent, EvidenceKind.CLIENT, at_ms=at_ms)
    if isinstance(made, Refusal):
        return made
    access = _access(
        made, minting, client_id=family.client_id, resource=family.resource, scope=family.scope, family=family.family
    )
    return (made, access)


def _scope(grants: tuple[Grant, ...], ceiling: Tier, audience: str, not_before: int, not_after: int) -> Scope:
    """The scope of a client: one audience, and nobody to lend it to."""
    return Scope(
        grants=grants,
        ceiling=ceiling,
        audiences=frozenset({audience}),
        delegates=frozenset(),
        depth=0,
        not_before=not_before,
        not_after=not_after,
    )


def _lent(minting: Minting, scope: Scope, *, purpose: str, mandate_id: str | None) -> issuance.Lent:
    return issuance.Lent(
        purpose=purpose,
        scope=scope,
        request_digest=minting.request_digest,
        evidence=minting.evidence,
        token_id=minting.token_id,
        hop_id=minting.hop_id,
        signed=minting.signed,
        mandate_id=mandate_id,
    )


def _access(
    made: TokenIssued, minting: Minting, *, client_id: str, resource: str, scope: str, family: str | None
) -> AccessMade:
    return AccessMade(
        AccessRecord(
            jti=made.hop.hop_id,
            token_id=made.token_id,
            family=family,
            client_id=client_id,
            actors=(made.hop.agent,),
            sponsor=made.sponsor.subject,
            authenticated_at=made.sponsor.authenticated_at,
            audience=resource,
            scope=scope,
            jkt=minting.jkt,
            issued_at=made.hop.attestation.at,
            not_after=made.scope.not_after,
        )
    )


def _of_hop(event: TokenDelegated, resource: str) -> AccessRecord:
    hop, chain = event.hop, event.chain
    return AccessRecord(
        jti=hop.hop_id,
        token_id=chain.token_id,
        family=None,
        client_id=hop.agent,
        actors=(hop.agent, *(above.agent for above in reversed(chain.hops))),
        sponsor=chain.sponsor.subject,
        authenticated_at=chain.sponsor.authenticated_at,
        audience=resource,
        scope="",
        jkt=thumbprint(hop.key),
        issued_at=hop.attestation.at,
        not_after=event.scope.not_after,
    )

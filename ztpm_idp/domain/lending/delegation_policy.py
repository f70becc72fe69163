"""Policies on delegation (e2): decided from this provider's own state, before anything is signed.

Delegating moves nothing, so its tier is 0. Trust for consequential acts is judged where the token is used, over every
edge of the chain. Nobody is asked here: where the policies want a person's answer, nothing is delegated.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Tier
from policies.conduct.behaviour import reading
from policies.conduct.trust import TrustState, chain_trust
from policies.decision.pdp import decide
from policies.evidence.evidence import NOT_COLLECTED, Evidence, NotCollected, ToolReading, TrustReading
from policies.evidence.model import Effect, ObligationKind, Point, Request
from policies.words.reason_table import REASONS, Reason
from ztpm_idp.domain import conduct
from ztpm_idp.domain.codes import Refusal
from ztpm_idp.domain.parties import RegisteredAgent

if TYPE_CHECKING:
    from capabilities.values.chain import Chain
    from policies.evidence.model import Decision
    from ztpm_idp.domain.commands import Delegate
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

DONE_HERE: Final = frozenset({ObligationKind.RECORD, ObligationKind.REATTEST})
"""Obligations that every delegation meets: it stands in the ledger, and the delegate is attested for it.

A policy that asks for more permits nothing here.
"""


def judged(
    rules: Rules, state: State, command: Delegate, chain: Chain, *, audience: str, at_ms: int
) -> tuple[Decision, Refusal | None]:
    """Decision of the policies, and the refusal that follows unless they permit.

    Args:
        rules: name the policies.
        state: with the conduct of every holder in the chain.
        command: of the holder.
        chain: the holder's, verified; its possession is proven.
        audience: one that the token is good for.
        at_ms: now, wall clock.
    """
    request = Request(
        request_id=command.hop_id,
        points=frozenset({Point.AGENT}),
        audience=audience,
        object=command.delegate,
        operation=conduct.DELEGATE,
        values=(),
        at=at_ms / 1_000,
    )
    holder = chain.leaf.agent
    evidence = Evidence(
        at=at_ms / 1_000,
        at_ms=at_ms,
        chain=chain,
        proof=True,
        # No tool, but an operation of this provider's own, with a tier.
        tool=ToolReading(name=conduct.DELEGATE, approved_digest="", actual_digest="", base_tier=Tier.NO_EFFECT),
        trust=_trust(rules, state, chain, at=at_ms // 1_000),
        behaviour=reading(conduct.of(state, holder).behaviour, holder, at_ms // 1_000, 0, rules.policies.parameters)
        if _all_seen(state, chain)
        else NOT_COLLECTED,
    )
    decision = decide(request, evidence, rules.policies)
    match decision.effect:
        case Effect.PERMIT:
            beyond = sorted(o.kind for o in decision.obligations if o.kind not in DONE_HERE)
            if not beyond:
                return decision, None
            return decision, Refusal(Reason.OBLIGATION_UNMET, f"no delegation is bound to: {', '.join(beyond)}")
        case Effect.DENY:
            return decision, Refusal(decision.reason, f"{decision.primitive} {REASONS[decision.reason].remedy}".strip())
        case Effect.DEFER:
            why = "a person would have to answer, and no delegation is asked of people"
            return decision, Refusal(decision.reason, f"{decision.primitive}: {why}")


def _trust(rules: Rules, state: State, chain: Chain, *, at: int) -> TrustReading | NotCollected:
    """Trust along the holder's chain: the stated trust in each holder, and the reports about it."""
    if not _all_seen(state, chain):
        return NOT_COLLECTED
    agents = [hop.agent for hop in chain.hops]
    stated = [
        party.trust_permille for agent in agents if isinstance(party := state.parties.get(agent), RegisteredAgent)
    ]
    accounts = {
        edge: by_reporter for agent in agents for edge, by_reporter in conduct.of(state, agent).trust.accounts.items()
    }
    parties = (chain.sponsor.subject, *agents)
    reported = TrustState(MappingProxyType(accounts))
    return chain_trust(stated, rules.policies.parameters, parties=parties, state=reported, at=at)


def _all_seen(state: State, chain: Chain) -> bool:
    """True where the conduct of each holder was loaded; without it nothing is known to be well."""
    return all(isinstance(state.parties.get(hop.agent), RegisteredAgent) for hop in chain.hops)

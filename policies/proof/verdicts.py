"""Verdicts of known primitives on facts, and of predicates made of them: the twin of `judge` and `evaluate`.

A primitive whose class has no row here is unknown: its verdict is a fact, so it may be any. That proves less and never
too much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

from capabilities.values.scope import Tier
from policies.decision.combine import AllOf, Always, AnyOf, Check, Not, Predicate, checks
from policies.evidence.tiers import UNSEEN_FLOOR
from policies.primitives import cognition, identity, propagation, tools
from policies.proof.facts import Facts, PrimitiveVerdict
from policies.proof.logic import Logic, Number, Truth, highest, implies

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from policies.decision.policy import PolicySet
    from policies.primitives.base import Primitive


@dataclass(frozen=True, slots=True)
class Situation:
    """Facts as primitives see them: with the parts that the set adds.

    Attributes:
        facts: of the case.
        physical: whether the operation has a physical dependency in this set.
        tier_known, tier: of the case as it is decided; the number means nothing while it is not known.
        logic: of the truths and numbers.
    """

    facts: Facts
    physical: Truth
    tier_known: Truth
    tier: Number
    logic: Logic


def situation(facts: Facts, physical: Truth, logic: Logic) -> Situation:
    """The twin of `policies.evidence.tiers.runtime_tier`."""
    known = logic.every(facts.base_known, logic.some(logic.no(physical), facts.impact_read))
    return Situation(facts, physical, known, logic.choose(physical, world_tier(facts, logic), facts.base_tier), logic)


def world_tier(facts: Facts, logic: Logic) -> Number:
    """Tier of an act by the world alone, independent of a set.

    It means nothing while a part is not known.
    """
    floor = logic.choose(facts.seen_fresh, int(Tier.NO_EFFECT), int(UNSEEN_FLOOR))
    return highest(logic, facts.base_tier, facts.impact_tier, floor)


def within(age_s: Number, bound_s: int, skew_s: int, logic: Logic) -> Truth:
    """The twin of `policies.primitives.base.age_within`."""
    return logic.every(-skew_s <= age_s, age_s <= bound_s)


def _all_or_nothing(holds: Truth, logic: Logic) -> PrimitiveVerdict:
    return PrimitiveVerdict(holds, logic.no(holds))


# --- the primitives --------------------------------------------------------------------------------------------------


def _agent_authentication(primitive: identity.AgentAuthentication, at: Situation) -> Truth:
    fresh = within(at.facts.leaf_age_s, primitive.attestation_age_s, primitive.skew_s, at.logic)
    return at.logic.every(at.facts.chain_verified, at.facts.proof_valid, fresh)


def human_root(primitive: identity.HumanRoot, at: Situation) -> Truth:
    """AID-2: on the runtime tier, or the base tier while that one is not known."""
    facts, logic = at.facts, at.logic
    tier = logic.choose(at.tier_known, at.tier, facts.base_tier)
    recent = logic.every(
        *(
            implies(logic, tier == int(t), within(facts.sponsor_age_s, primitive.bound_s(t), primitive.skew_s, logic))
            for t in Tier
        )
    )
    return logic.every(facts.chain_verified, facts.sponsor_named, facts.base_known, recent)


def _link_validity(primitive: identity.LinkValidity, at: Situation) -> Truth:
    facts, logic = at.facts, at.logic
    lease_ms = logic.choose(at.physical, primitive.lease_motion_ms, primitive.lease_other_ms)
    in_window = logic.every(facts.begun, facts.unexpired)
    return logic.every(facts.chain_verified, in_window, facts.view_age_ms >= 0, facts.view_age_ms <= lease_ms)


def _bounded_chain(primitive: identity.BoundedChain, at: Situation) -> Truth:
    facts, logic = at.facts, at.logic
    lived = logic.every(facts.lifetime_s > 0, facts.lifetime_s <= primitive.lifetime_max_s)
    deep = facts.delegations <= primitive.hops_max_count
    return logic.every(facts.chain_verified, facts.audience_meant, facts.delegations >= 0, deep, lived)


def _verified(_: object, at: Situation) -> Truth:
    """AID-4 and CATP-2 on facts: the result of verification."""
    return at.facts.chain_verified


def _boundary_attestation(primitive: propagation.BoundaryAttestation, at: Situation) -> Truth:
    facts, bound_s, skew_s = at.facts, primitive.attestation_age_s, primitive.skew_s
    ages = (facts.youngest_age_s, facts.oldest_age_s)
    return at.logic.every(facts.chain_verified, *(within(age, bound_s, skew_s, at.logic) for age in ages))


def _tool_scope(_: object, at: Situation) -> Truth:
    facts, logic = at.facts, at.logic
    return logic.every(facts.chain_verified, logic.some(facts.request_free, facts.after_the_grant))


def _parameter_limits(_: object, at: Situation) -> Truth:
    return at.logic.every(at.facts.chain_verified, at.facts.request_free, at.facts.robot_free)


def _tool_identity(_: object, at: Situation) -> Truth:
    return at.facts.tool_pinned


def _sensor_provenance(_: object, at: Situation) -> Truth:
    facts, logic = at.facts, at.logic
    late = logic.every(facts.impact_read, facts.seen_fresh, facts.view_late)
    return logic.every(facts.view_known, logic.no(facts.view_invalid), logic.no(late))


def _state_preconditions(_: object, at: Situation) -> Truth:
    return at.logic.every(at.facts.robot_known, at.facts.robot_ready)


def _dynamic_trust(primitive: propagation.DynamicTrust, at: Situation) -> PrimitiveVerdict:
    facts, logic = at.facts, at.logic
    score = facts.trust_permille
    stated = logic.every(facts.trust_known, score >= 0, score <= 1000)
    unasked = logic.every(at.tier_known, at.tier < int(Tier.CONSEQUENTIAL))
    enough = logic.some(primitive.trust_theta_permille <= score, unasked)
    return PrimitiveVerdict(logic.every(stated, enough), logic.no(stated))


def _physical_impact_gate(_: object, at: Situation) -> PrimitiveVerdict:
    facts, logic = at.facts, at.logic
    tier = world_tier(facts, logic)
    judged = logic.every(
        facts.chain_verified, facts.impact_read, facts.base_known, facts.index_valid, logic.no(facts.violated)
    )
    judged = logic.every(judged, tier <= facts.ceiling)
    holds = logic.every(judged, tier < int(Tier.HIGH_CONSEQUENCE))
    critical = tier == int(Tier.SAFETY_CRITICAL)
    refused = logic.every(critical, logic.no(facts.opening_in_force))
    return PrimitiveVerdict(holds, logic.some(logic.no(judged), refused))


HOLDS: Final[Mapping[type, Callable[[Any, Situation], Truth]]] = {
    identity.AgentAuthentication: _agent_authentication,
    identity.HumanRoot: human_root,
    identity.LinkValidity: _link_validity,
    identity.NoScopeEscalation: _verified,
    identity.BoundedChain: _bounded_chain,
    propagation.ScopeNarrowing: _verified,
    propagation.BoundaryAttestation: _boundary_attestation,
    tools.ToolScope: _tool_scope,
    tools.ParameterLimits: _parameter_limits,
    tools.ToolIdentity: _tool_identity,
    cognition.SensorProvenance: _sensor_provenance,
    tools.StatePreconditions: _state_preconditions,
}
"""The known primitives that hold or fail, and ask nobody."""
MAY_DEFER: Final[Mapping[type, Callable[[Any, Situation], PrimitiveVerdict]]] = {
    propagation.DynamicTrust: _dynamic_trust,
    tools.PhysicalImpactGate: _physical_impact_gate,
}
"""The known primitives for which a person may answer."""


def is_known(primitive: Primitive) -> bool:
    """True where the verdict of the primitive follows from the facts."""
    return type(primitive) in HOLDS or type(primitive) in MAY_DEFER


def unknowns(policies: PolicySet) -> tuple[Primitive, ...]:
    """The primitives of a set, and of its floor, that are not known here, each once, by id."""
    members = (*policies.policies, *(policies.floor.policies if policies.floor else ()))
    found = {p for policy in members for p, _ in checks(policy.predicate) if not is_known(p)}
    return tuple(sorted(found, key=lambda p: (p.id, repr(p))))


def _verdict_of(primitive: Primitive, at: Situation) -> PrimitiveVerdict:
    if (holds := HOLDS.get(type(primitive))) is not None:
        return _all_or_nothing(holds(primitive, at), at.logic)
    if (verdict := MAY_DEFER.get(type(primitive))) is not None:
        return verdict(primitive, at)
    return at.facts.unknown[primitive]


# --- predicates ------------------------------------------------------------------------------------------------------


def verdict_of(predicate: Predicate, at: Situation) -> PrimitiveVerdict:
    """The twin of `policies.decision.combine.evaluate`: every part is asked, so a part that raises is heard of."""
    logic = at.logic
    match predicate:
        case Check(primitive):
            return _verdict_of(primitive, at)
        case Always():
            return PrimitiveVerdict(holds=True, fails=False)
        case Not(part):
            turned = verdict_of(part, at)
            return PrimitiveVerdict(turned.fails, turned.holds, turned.raises)
        case AllOf(parts):
            verdicts = [verdict_of(part, at) for part in parts]
            return PrimitiveVerdict(
                logic.every(*(v.holds for v in verdicts)),
                logic.some(*(v.fails for v in verdicts)),
                logic.some(*(v.raises for v in verdicts)),
            )
        case AnyOf(parts):
            verdicts = [verdict_of(part, at) for part in parts]
            return PrimitiveVerdict(
                logic.some(*(v.holds for v in verdicts)),
                logic.every(*(v.fails for v in verdicts)),
                logic.some(*(v.raises for v in verdicts)),
            )
        case _:
            assert_never(predicate)

"""Outcome of a set on facts: the twin of `policies.decide`, down to the use of an approval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capabilities.values.scope import Tier
from policies.decision.approval import APPROVERS_OF_TIER
from policies.evidence.model import Effect
from policies.proof.facts import DENIED, GRANTED, Facts, Names
from policies.proof.logic import Logic, Number, Truth, implies
from policies.proof.verdicts import Situation, situation, verdict_of

if TYPE_CHECKING:
    from policies.decision.policy import Policy, PolicySet
    from policies.proof.facts import PrimitiveVerdict


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a decision on facts.

    Attributes:
        permit, defer, deny: exactly one is true.
        by_people: the PERMIT rests on an approval, whose use it consumes.
        at: the situation in which it was decided.
    """

    permit: Truth
    defer: Truth
    deny: Truth
    by_people: Truth
    at: Situation


@dataclass(frozen=True, slots=True)
class PolicyOutcome:
    """Answer of one policy on facts; neither `denies` nor `defers` is a PERMIT or silence.

    Attributes:
        denies, defers: never both.
        grants: it may permit.
    """

    denies: Truth
    defers: Truth
    grants: Truth = False


@dataclass(frozen=True, slots=True)
class Added:
    """One more DENY policy, of which nothing is known: its concern and its answer are open.

    A DENY policy denies, defers or is silent, and grants nothing (policies.decision.pdp, `_speak`); one that errors
    denies.
    """

    concerns: Truth
    denies: Truth
    defers: Truth


def outcome(policies: PolicySet, facts: Facts, names: Names, logic: Logic, added: Added | None = None) -> Outcome:
    """Outcome of `policies`, and of the policy that is added to them, on `facts`."""
    concerned = _concerned(policies, facts, names, logic)
    bound = logic.some(*(concern for policy, concern in concerned if policy.pit_bound is not None))
    anybody = logic.some(*(concern for _, concern in concerned), added.concerns if added else False)
    # [POL-7] an operation that no policy names counts as physical
    at = situation(facts, logic.some(logic.no(anybody), bound), logic)
    said = answers(policies, at, names)
    if added is not None:
        said.append(_only_when(added.concerns, PolicyOutcome(added.denies, added.defers), logic))
    # deny-overrides, then DEFER over PERMIT; nothing is permitted that no policy permits
    grants = logic.some(*(s.grants for s in said))
    refused = logic.some(logic.no(facts.well_formed), logic.no(grants), *(s.denies for s in said))
    deferred = logic.every(logic.no(refused), logic.some(*(s.defers for s in said)))
    # people may be asked, and their answer may count
    hopeless = logic.every(_critical(at), logic.no(facts.opening_in_force))
    answered = logic.every(deferred, logic.no(hopeless), facts.approval == GRANTED)
    by_people = logic.every(answered, logic.no(_too_fast(at)), approval_fits(at))
    denied_by_people = logic.some(hopeless, facts.approval == DENIED, logic.every(answered, _too_fast(at)))
    deny = logic.some(refused, logic.every(deferred, denied_by_people))
    permit = logic.some(logic.every(logic.no(refused), logic.no(deferred)), by_people)
    return Outcome(permit, logic.every(logic.no(permit), logic.no(deny)), deny, by_people, at)


def answers(policies: PolicySet, at: Situation, names: Names) -> list[PolicyOutcome]:
    """Answer of each policy of a set in a situation; one that is not concerned is silent."""
    concerned = _concerned(policies, at.facts, names, at.logic)
    return [_only_when(concern, _said(policy, at, names), at.logic) for policy, concern in concerned]


def _concerned(policies: PolicySet, facts: Facts, names: Names, logic: Logic) -> list[tuple[Policy, Truth]]:
    return [(policy, concerns(policy, facts, names, logic)) for policy in policies.policies]


def concerns(policy: Policy, facts: Facts, names: Names, logic: Logic) -> Truth:
    """True where point, object and operation are meant, for any caller: the twin of `Policy.concerns`."""
    thing = policy.object
    return logic.every(
        logic.some(*(facts.stands_for(point) for point in sorted(policy.points))),
        _named("object", thing.ids, facts, names, logic),
        _named("operation", thing.operations, facts, names, logic),
        logic.no(_named("operation", thing.without, facts, names, logic)),
    )


def _named(kind: str, members: frozenset[str] | None, facts: Facts, names: Names, logic: Logic) -> Truth:
    """True where the case's name of this kind is a member; None means any."""
    if members is None:
        return True
    name: Number = getattr(facts, kind)
    return logic.some(*(name == place for place in names.places(kind, members)))


def _only_when(concern: Truth, said: PolicyOutcome, logic: Logic) -> PolicyOutcome:
    return PolicyOutcome(*(logic.every(concern, part) for part in (said.denies, said.defers, said.grants)))


def _said(policy: Policy, at: Situation, names: Names) -> PolicyOutcome:
    """Answer of one policy to a request that it concerns."""
    facts, logic = at.facts, at.logic
    everybody = policy.subject.agents is None and policy.subject.sponsors is None
    meant = logic.every(
        _named("agent", policy.subject.agents, facts, names, logic),
        _named("sponsor", policy.subject.sponsors, facts, names, logic),
    )
    # without a verified chain nobody knows who calls
    nobody = logic.every(not everybody, logic.no(facts.chain_verified))
    spoken = logic.some(nobody, meant)
    verdict = verdict_of(policy.predicate, at)
    match policy.effect:
        case Effect.PERMIT:
            said = _required(policy, verdict, at)
            denies = logic.every(spoken, logic.some(nobody, verdict.raises, said.denies))
            defers = logic.every(spoken, logic.no(denies), said.defers)
            # a policy that errors grants nothing; one that cannot speak for the caller was never asked
            return PolicyOutcome(denies, defers, logic.every(spoken, logic.some(nobody, logic.no(verdict.raises))))
        case Effect.DENY | Effect.DEFER:
            undecided = logic.every(logic.no(verdict.holds), logic.no(verdict.fails))
            denies = logic.some(verdict.raises, verdict.holds if policy.effect is Effect.DENY else False)
            asks = logic.some(undecided, verdict.holds if policy.effect is Effect.DEFER else False)
            return PolicyOutcome(
                logic.every(spoken, denies), logic.every(spoken, logic.no(verdict.raises), logic.no(denies), asks)
            )


def _required(policy: Policy, verdict: PrimitiveVerdict, at: Situation) -> PolicyOutcome:
    """A requirement: the twin of `policies.decision.pdp._permit`."""
    facts, logic = at.facts, at.logic
    undecided = logic.every(logic.no(verdict.holds), logic.no(verdict.fails))
    if policy.pit_bound is None:
        return PolicyOutcome(verdict.fails, undecided)
    bound = int(policy.pit_bound)
    reached = logic.every(verdict.holds, at.tier_known, bound <= at.tier)
    hopeless = logic.every(reached, _critical(at), logic.no(facts.opening_in_force))
    denies = logic.some(verdict.fails, logic.every(verdict.holds, logic.no(at.tier_known)), hopeless)
    return PolicyOutcome(denies, logic.some(undecided, logic.every(reached, logic.no(hopeless))))


def _critical(at: Situation) -> Truth:
    return at.logic.every(at.tier_known, at.tier == int(Tier.SAFETY_CRITICAL))


def approval_fits(at: Situation) -> Truth:
    """The case is the approved one, as it is now: the twin of `policies.decision.approval._differences`."""
    facts, logic = at.facts, at.logic
    critical = facts.approval_tier == int(Tier.SAFETY_CRITICAL)
    seen = logic.some(facts.seen_fresh, facts.approval_sees_clear)
    wanted = logic.choose(critical, APPROVERS_OF_TIER.get(Tier.SAFETY_CRITICAL, 1), 1)
    return logic.every(
        facts.chain_verified,
        facts.approval_same_sponsor,
        facts.approval_same_policies,
        at.tier_known,
        at.tier == facts.approval_tier,
        facts.approval_lists_all,
        implies(logic, at.physical, logic.every(facts.impact_read, facts.approval_same_impact, seen)),
        wanted <= facts.approvers,
        facts.approval_uses_left,
        facts.approval_in_time,
        facts.approval_recent,
        implies(logic, critical, logic.every(facts.opening_in_force, facts.opening_its_own, facts.opening_recent)),
    )


def _too_fast(at: Situation) -> Truth:
    """Faster than people may approve: the twin of `policies.decision.approval._too_fast`."""
    facts, logic = at.facts, at.logic
    watched = logic.some(at.tier == int(Tier.HIGH_CONSEQUENCE), logic.no(facts.seen_fresh))
    allowed = logic.every(facts.slow, logic.some(facts.soft, _critical(at)))
    return logic.every(at.physical, facts.impact_read, watched, logic.no(allowed))

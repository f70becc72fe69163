"""Confirmation that real decisions break a claim, from requests, evidence and answers of `decide` alone.

Nothing here knows facts or formulas: it is the other half of `policies.proof.claims`, in the words of the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Chain
from capabilities.values.scope import Tier
from policies.decision import pdp
from policies.decision.policy import Concern, requirement
from policies.evidence.evidence import (
    ApprovalReading,
    DeclaredImpact,
    ImpactReading,
    PerceptionReading,
    RobotReading,
    prior_leave,
)
from policies.evidence.model import SEVERITY, Effect, Obligation, ObligationKind, Point
from policies.evidence.tiers import base_tier, runtime_tier
from policies.primitives.base import Case, Holds
from policies.primitives.cognition import BELIEVED
from policies.primitives.identity import HumanRoot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from policies.decision.policy import PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision, Request
    from policies.words.parameters import Parameters

MOVING: Final = frozenset({Point.TOOL, Point.ACTUATION})
"""Points at which an operation is called or carried out; at the others something is said or read."""
PEOPLE_AT_TIER_4: Final = 2
"""Number of people at tier 4 (DESIGN section 6), stated apart from the code that is judged."""
CONSUME: Final = Obligation(ObligationKind.CONSUME)


@dataclass(frozen=True, slots=True)
class DecidedCase:
    """Case with the decision of `decide`."""

    request: Request
    evidence: Evidence
    policies: PolicySet
    decision: Decision

    @property
    def permitted(self) -> bool:
        """True where the answer is PERMIT."""
        return self.decision.effect is Effect.PERMIT


def human_root(parameters: Parameters) -> HumanRoot:
    """AID-2 with a set's own numbers, lowered so that no higher tier allows an older authentication."""
    values = {f.name: getattr(parameters, f.name) for f in fields(HumanRoot)}
    bound_s = values["sponsor_age_tier_0_s"]
    for tier in range(5):
        bound_s = min(bound_s, values[f"sponsor_age_tier_{tier}_s"])
        values[f"sponsor_age_tier_{tier}_s"] = bound_s
    return HumanRoot(**values)


def act_permitted(told: DecidedCase, harmless: frozenset[str]) -> bool:
    """A physical act is permitted: an operation not known to be harmless, where operations have an effect."""
    return told.permitted and told.request.operation not in harmless and bool(told.request.points & MOVING)


def no_human_root(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """A physical act is permitted while AID-2 does not hold."""
    (told,) = all_told
    physical = requirement(told.request, told.policies).physical
    case = Case(told.request, told.evidence, physical, told.decision.tier)
    return act_permitted(told, harmless) and not isinstance(human_root(told.policies.parameters).judge(case), Holds)


def no_approval(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """A physical act of tier 3 or 4 is permitted without the people whom the tier needs."""
    (told,) = all_told
    tier = runtime_tier(told.evidence, physical=True)
    if tier is None or tier < Tier.HIGH_CONSEQUENCE or not act_permitted(told, harmless):
        return False
    return not _rests_on_people(told, tier)


def _rests_on_people(told: DecidedCase, tier: Tier) -> bool:
    evidence, approval, use = told.evidence, told.evidence.approval, told.decision.approval
    if not isinstance(approval, ApprovalReading) or use is None or CONSUME not in told.decision.obligations:
        return False
    leave = prior_leave(evidence)
    opened = tier < Tier.SAFETY_CRITICAL or (leave is not None and leave.opening_id == approval.opening_id)
    return (
        opened
        and (use.ask_id, use.use) == (approval.ask_id, approval.use)
        and approval.state == "granted"
        and approval.tier == tier
        and approval.policy_digest == told.policies.digest
        and isinstance(evidence.chain, Chain)
        and approval.sponsor == evidence.chain.sponsor.subject
        and len(set(approval.approvers)) >= (PEOPLE_AT_TIER_4 if tier is Tier.SAFETY_CRITICAL else 1)
        and approval.uses_left >= 1
        and evidence.at <= approval.not_after
        and 0 <= approval.age_ms <= told.policies.parameters.lease_motion_ms
    )


def above_ceiling(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """A physical act above the ceiling of its token is permitted."""
    (told,) = all_told
    tier, chain = runtime_tier(told.evidence, physical=True), told.evidence.chain
    above = tier is not None and isinstance(chain, Chain) and tier > chain.scope.ceiling
    return above and act_permitted(told, harmless)


def milder_for_a_denial(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """True where a denied or deferred request is permitted once a DENY policy is added."""
    del harmless
    before, after = all_told
    added = set(after.policies.policies) - set(before.policies.policies)
    only_denials = len(added) == 1 and all(policy.effect is Effect.DENY for policy in added)
    return only_denials and not before.permitted and after.permitted


def milder_for_a_tier(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """True where the same act gets a milder answer at a higher tier."""
    del harmless
    lower, higher = all_told
    approval = higher.evidence.approval
    granted = isinstance(approval, ApprovalReading) and approval.state == "granted"
    if lower.decision.tier is None or higher.decision.tier is None or not lower.decision.tier <= higher.decision.tier:
        return False
    if not granted:
        return SEVERITY[higher.decision.effect] < SEVERITY[lower.decision.effect]
    for_this_tier = isinstance(approval, ApprovalReading) and approval.tier == higher.decision.tier
    by_people = higher.decision.approval is not None and for_this_tier
    return higher.permitted and not lower.permitted and not by_people


def a_fault_permits(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """A physical act is permitted on evidence that is a fault, a refusal, a violation, or missing."""
    (told,) = all_told
    return act_permitted(told, harmless) and not _whole(told.request, told.evidence)


def _whole(request: Request, evidence: Evidence) -> bool:
    """True where all evidence that an act needs is there, and none of it speaks against the act."""
    impact, view = evidence.impact, evidence.perception
    authority = isinstance(evidence.chain, Chain) and evidence.proof is True
    asked = evidence.request_fault is None and evidence.robot_fault is None
    computed = isinstance(impact, ImpactReading) and impact.violations == ()
    world = (computed or isinstance(impact, DeclaredImpact)) and base_tier(evidence) is not None
    if Point.ACTUATION in request.points:
        seen = isinstance(view, PerceptionReading) and all(sensor.state in BELIEVED for sensor in view.sensors)
        world = world and seen and isinstance(evidence.robot, RobotReading)
    return authority and asked and world


def loses_a_denial(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """Something is permitted that a kept policy of the extended set denies, or without people whom it asks."""
    del harmless
    (told,) = all_told
    floor, asked = told.policies.floor, told.decision.approval is None
    if floor is None or not told.permitted:
        return False
    physical = requirement(told.request, told.policies).physical
    case = Case(told.request, told.evidence, physical, told.decision.tier)
    kept = (policy for policy in floor.policies if policy.concerns(told.request) is Concern.YES)
    said = {pdp._answer(policy, case).effect for policy in kept}  # noqa: SLF001 - the very function that decides
    return Effect.DENY in said or (asked and Effect.DEFER in said)


def nobody_thought_of_it(all_told: Sequence[DecidedCase], harmless: frozenset[str]) -> bool:
    """An operation that no policy names is permitted while its impact was not asked for, or not computed."""
    (told,) = all_told
    named = {
        name
        for policy in told.policies.policies
        for name in (policy.object.operations or frozenset()) | policy.object.without
    }
    physics = requirement(told.request, told.policies).physical and isinstance(
        told.evidence.impact, ImpactReading | DeclaredImpact
    )
    return act_permitted(told, harmless) and told.request.operation not in named and not physics

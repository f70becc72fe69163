"""The claims about a policy set, each as a formula over facts, beside the judgement that shows it broken.

The judgement (policies.proof.confirmation) says the same in other words and is put to the real decisions of a
counterexample: a formula that claims too much is found out there.

A physical act is an operation that is not called harmless, at a point where operations have an effect (e4, e5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Tier
from policies.proof import confirmation as shown
from policies.proof.facts import GRANTED, Names
from policies.proof.logic import Logic, Truth, implies
from policies.proof.outcome import answers
from policies.proof.verdicts import human_root, world_tier

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from policies.decision.policy import PolicySet
    from policies.proof.confirmation import DecidedCase
    from policies.proof.facts import Facts
    from policies.proof.outcome import Added, Outcome


@dataclass(frozen=True, slots=True)
class Question:
    """Question to the prover: a set, the operations that are called harmless, and the names that matter to both."""

    policies: PolicySet
    harmless: frozenset[str]
    names: Names
    logic: Logic

    def acts(self, facts: Facts) -> Truth:
        """True where the request is a physical act."""
        harmless = (facts.operation == self.names.place("operation", name) for name in sorted(self.harmless))
        moving = (facts.stands_for(point) for point in sorted(shown.MOVING))
        return self.logic.every(self.logic.no(self.logic.some(*harmless)), self.logic.some(*moving))

    def permits(self, outcome: Outcome) -> Truth:
        """True where a physical act is permitted."""
        return self.logic.every(outcome.permit, self.acts(outcome.at.facts))


@dataclass(frozen=True, slots=True)
class Cases:
    """The facts of the cases that a claim compares.

    Attributes:
        facts: of one case or two.
        added: the policy that is added for the second, or None.
    """

    facts: tuple[Facts, ...]
    added: Added | None = None


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim.

    Attributes:
        id, says: its name, and the claim in one sentence.
        broken: when the outcomes of its cases break it.
        shown: whether real decisions break it.
        matters: when an outcome is one that the claim is about, so that a claim about nothing is found out; None where
            it is about every request.
        compares: "" for a claim about single cases, "a set" for one about two sets on single cases, else the difference
            of the second case: "a policy" or "a tier".
    """

    id: str
    says: str
    broken: Callable[[Question, Sequence[Outcome]], Truth]
    shown: Callable[[Sequence[DecidedCase], frozenset[str]], bool]
    matters: Callable[[Question, Outcome], Truth] | None = None
    compares: str = ""


def _known_tier(facts: Facts, logic: Logic) -> Truth:
    return logic.every(facts.base_known, facts.impact_read)


def _no_human_root(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    (outcome,) = outcomes
    root = human_root(shown.human_root(question.policies.parameters), outcome.at)
    return question.logic.every(question.permits(outcome), question.logic.no(root))


def _high(question: Question, outcome: Outcome) -> Truth:
    facts, logic = outcome.at.facts, question.logic
    high = int(Tier.HIGH_CONSEQUENCE) <= world_tier(facts, logic)
    return logic.every(question.permits(outcome), _known_tier(facts, logic), high)


def _no_approval(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    (outcome,) = outcomes
    facts, logic = outcome.at.facts, question.logic
    tier = world_tier(facts, logic)
    critical = tier == int(Tier.SAFETY_CRITICAL)
    wanted = logic.choose(critical, shown.PEOPLE_AT_TIER_4, 1)
    people = logic.every(
        outcome.by_people,
        facts.chain_verified,
        facts.approval == GRANTED,
        facts.approval_tier == tier,
        facts.approval_same_policies,
        facts.approval_same_sponsor,
        wanted <= facts.approvers,
        facts.approval_uses_left,
        facts.approval_in_time,
        facts.approval_recent,
        implies(logic, critical, logic.every(facts.opening_in_force, facts.opening_its_own)),
    )
    return logic.every(_high(question, outcome), logic.no(people))


def _above_ceiling(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    (outcome,) = outcomes
    facts, logic = outcome.at.facts, question.logic
    above = logic.every(facts.chain_verified, _known_tier(facts, logic), facts.ceiling < world_tier(facts, logic))
    return logic.every(question.permits(outcome), above)


def _milder_for_a_denial(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    before, after = outcomes
    return question.logic.every(question.logic.no(before.permit), after.permit)


def _milder_for_a_tier(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    lower, higher = outcomes
    logic, facts = question.logic, higher.at.facts
    both_known = logic.every(lower.at.tier_known, higher.at.tier_known, lower.at.tier <= higher.at.tier)
    granted = facts.approval == GRANTED
    milder = logic.some(
        logic.every(lower.deny, logic.no(higher.deny)), logic.every(logic.no(lower.permit), higher.permit)
    )
    for_this_tier = logic.every(higher.by_people, facts.approval_tier == higher.at.tier)
    gained = logic.every(higher.permit, logic.no(lower.permit), logic.no(for_this_tier))
    return logic.every(both_known, logic.choose(granted, gained, milder))


def _a_fault_permits(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    (outcome,) = outcomes
    facts, logic = outcome.at.facts, question.logic
    asked = logic.every(facts.proof_valid, facts.request_free, facts.robot_free)
    world = logic.every(facts.base_known, facts.impact_read, logic.no(facts.violated))
    seen = logic.every(facts.view_known, logic.no(facts.view_invalid), facts.robot_known)
    whole = logic.every(facts.chain_verified, asked, world, implies(logic, facts.e5, seen))
    return logic.every(question.permits(outcome), logic.no(whole))


def _unnamed(question: Question, outcome: Outcome) -> Truth:
    unnamed = question.names.named_operations <= outcome.at.facts.operation
    return question.logic.every(question.permits(outcome), unnamed)


def _nobody_thought_of_it(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    (outcome,) = outcomes
    physics = question.logic.every(outcome.at.physical, outcome.at.facts.impact_read)
    return question.logic.every(_unnamed(question, outcome), question.logic.no(physics))


def _loses_a_denial(question: Question, outcomes: Sequence[Outcome]) -> Truth:
    (outcome,) = outcomes
    floor, logic = question.policies.floor, question.logic
    kept = [] if floor is None else answers(floor, outcome.at, question.names)
    denied = logic.some(*(said.denies for said in kept))
    asked = logic.every(logic.no(outcome.by_people), logic.some(*(said.defers for said in kept)))
    return logic.every(outcome.permit, logic.some(denied, asked))


CLAIMS: Final = (
    Claim(
        id="P1",
        says="no physical act is permitted without a human root, authenticated recently enough for the tier (AID-2)",
        broken=_no_human_root,
        shown=shown.no_human_root,
        matters=Question.permits,
    ),
    Claim(
        id="P2",
        says="no physical act of tier 3 is permitted without an approval for it, none of tier 4 without two people's"
        " and a prior opening",
        broken=_no_approval,
        shown=shown.no_approval,
        matters=_high,
    ),
    Claim(
        id="P3",
        says="no physical act above the token's ceiling is permitted",
        broken=_above_ceiling,
        shown=shown.above_ceiling,
        matters=Question.permits,
    ),
    Claim(
        id="P4",
        says="no DENY policy, whichever is added, makes a PERMIT of anything else",
        broken=_milder_for_a_denial,
        shown=shown.milder_for_a_denial,
        compares="a policy",
    ),
    Claim(
        id="P5",
        says="a higher tier never has a milder answer, but for a PERMIT by people who approved that very tier",
        broken=_milder_for_a_tier,
        shown=shown.milder_for_a_tier,
        compares="a tier",
    ),
    Claim(
        id="P6",
        says="no physical act is permitted on a fault, a refusal, a violation or missing evidence",
        broken=_a_fault_permits,
        shown=shown.a_fault_permits,
        matters=Question.permits,
    ),
    Claim(
        id="P7",
        says="no physical act that the set does not name is permitted without its physics",
        broken=_nobody_thought_of_it,
        shown=shown.nobody_thought_of_it,
        matters=_unnamed,
    ),
)
"""All seven that are asked of every set, in order."""
EXTENDS: Final = Claim(
    id="P8",
    says="nothing is permitted that a policy denies, or asks about, which the set keeps of the one that it extends",
    broken=_loses_a_denial,
    shown=shown.loses_a_denial,
    compares="a set",
)


def claims_of(policies: PolicySet) -> tuple[Claim, ...]:
    """The claims that are asked of a set."""
    return CLAIMS if policies.floor is None else (*CLAIMS, EXTENDS)

"""Every member of a Decision, for every effect."""

from dataclasses import dataclass, replace

import pytest
from capabilities.values.scope import Tier
from policies.decision.combine import Always, Check
from policies.decision.obligations import NOTIFY, RECORD
from policies.evidence.model import ApprovalUse
from policies.primitives.base import Holds
from policies.words.reason_table import REASONS
from tests.policies import world

from policies import (
    NOT_COLLECTED,
    ROWS,
    Decision,
    Effect,
    Object,
    Obligation,
    ObligationKind,
    Parameters,
    Policy,
    PolicyError,
    PolicyFault,
    PolicySet,
    Reason,
    Subject,
    decide,
    load_shipped,
)

SET = load_shipped("paper-default")
POINTS = frozenset(ROWS["TEA-1"].points)


def test_a_permit():
    request, evidence = world.asked()
    plan = SET.plan(request)
    decision = decide(request, evidence, SET)
    assert decision == Decision(
        request_id="r-1",
        request_digest=request.digest,
        effect=Effect.PERMIT,
        reason=Reason.PERMITTED,
        primitive="",
        findings=(),
        tier=Tier.REVERSIBLE,
        index=1_000,
        obligations=decision.obligations,
        policy_digest=SET.digest,
        evidence=evidence,
        lifetime_ms=50,
        approval=None,
    )
    assert plan.obligations < set(decision.obligations)


def test_a_permit_by_people():
    request, evidence, policies = world.approved(Tier.HIGH_CONSEQUENCE)
    decision = decide(request, evidence, policies)
    assert (decision.request_id, decision.request_digest) == (request.request_id, request.digest)
    assert (decision.effect, decision.reason, decision.primitive) == (Effect.PERMIT, Reason.PERMITTED, "")
    assert (decision.findings, decision.tier, decision.index) == ((), Tier.HIGH_CONSEQUENCE, 2_500)
    assert (decision.approval, decision.lifetime_ms) == (ApprovalUse("a5" * 16, 1), 50)


@pytest.mark.parametrize(
    ("given", "effect", "reason", "primitive"),
    [
        ({"evidence.impact.tier": 3}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL, "TEA-4"),
        ({"evidence.chain.hops.1.ceiling": 0}, Effect.DENY, Reason.ABOVE_CEILING, "TEA-4"),
    ],
)
def test_a_refusal(given, effect, reason, primitive):
    request, evidence = world.asked(given)
    decision = decide(request, evidence, SET)
    assert decision == Decision(
        request_id="r-1",
        request_digest=request.digest,
        effect=effect,
        reason=reason,
        primitive=primitive,
        findings=decision.findings,
        tier=Tier(given.get("evidence.impact.tier", 1)),
        index=1_000,
        obligations=decision.obligations,
        policy_digest=SET.digest,
        evidence=evidence,
        lifetime_ms=0,
        approval=None,
    )
    assert (decision.findings[0].reason, decision.findings[0].primitive) == (reason, primitive)


def test_no_index_without_physics_and_without_a_physical_dependency():
    assert decide(*world.asked({"evidence.impact": "not collected"}), SET).index is None
    assert decide(*world.asked({"request.operation": "read_state"}), SET).index is None


def test_what_is_not_physical_lives_longer():
    arguments = {"evidence.context.arguments": [], "request.values": [], "request.operation": "read_state"}
    decision = decide(*world.asked(arguments), SET)
    assert (decision.effect, decision.lifetime_ms) == (Effect.PERMIT, 1_000)


def undecidable(name, digest, finding):
    """The Decision where nothing could be judged."""
    return Decision(
        request_id=name,
        request_digest="",
        effect=Effect.DENY,
        reason=finding.reason,
        primitive="",
        findings=(finding,),
        tier=None,
        index=None,
        obligations=(NOTIFY, RECORD),
        policy_digest=digest,
        evidence=None,
        lifetime_ms=0,
        approval=None,
    )


def test_evidence_that_is_not_of_its_shape():
    request, evidence = world.asked()
    decision = decide(request, replace(evidence, at=float("nan")), SET)
    (finding,) = decision.findings
    assert decision == undecidable("r-1", SET.digest, finding)
    assert (finding.primitive, finding.reason, finding.detail["place"]) == (
        "",
        Reason.EVIDENCE_MALFORMED,
        "evidence.at",
    )
    assert finding.detail["remedy"] == REASONS[finding.reason].remedy


def test_a_set_that_is_none():
    request, evidence = world.asked()
    decision = decide(request, evidence, None)
    (finding,) = decision.findings
    assert decision == undecidable("r-1", "", finding)
    assert (finding.primitive, finding.reason, finding.detail["error"]) == ("", Reason.POLICY_ERROR, "AttributeError")


@dataclass
class Odd:
    request_id: object = 1
    digest: object = 2


def test_names_that_are_none():
    for request, policies in ((Odd(), Odd()), (None, None)):
        decision = decide(request, None, policies)
        (finding,) = decision.findings
        assert decision == undecidable("", "", finding)
        assert finding.detail["place"] == "request"


def policy(identity, effect, predicate, subject=Subject(), pit_bound=None):
    record = frozenset({Obligation(ObligationKind.RECORD)})
    return Policy(identity, subject, Object(), predicate, POINTS, effect, record, pit_bound)


KNOWN = policy("known", Effect.PERMIT, Check(ROWS["TEA-1"].make()))


def answer(*policies, **changes):
    request, evidence = world.asked()
    return decide(request, replace(evidence, **changes), PolicySet("set", 1, policies, Parameters()))


@pytest.mark.parametrize(
    ("effect", "reason"), [(Effect.DENY, Reason.PROHIBITED), (Effect.DEFER, Reason.APPROVAL_REQUIRED)]
)
def test_a_prohibition_and_a_question_name_their_policy(effect, reason):
    decision = answer(KNOWN, policy("other", effect, Always()))
    assert (decision.effect, decision.reason, decision.primitive) == (effect, reason, "")
    assert decision.findings[0].detail == {"policy": "other", "remedy": REASONS[reason].remedy}
    assert len(decision.findings) == 1


def test_a_permit_for_somebody_speaks_for_nobody_while_nobody_knows_who_calls():
    somebody = policy("somebody", Effect.PERMIT, Check(ROWS["TEA-1"].make()), Subject(frozenset({"robotic"})))
    assert answer(somebody).effect is Effect.PERMIT
    decision = answer(somebody, chain=NOT_COLLECTED)
    # its own finding, and not that of a set in which nothing may permit
    assert [(f.primitive, f.reason) for f in decision.findings] == [("AID-1", Reason.EVIDENCE_MISSING)]
    assert decision.findings[0].detail["evidence"] == "chain"
    assert answer(KNOWN, somebody, chain=NOT_COLLECTED).effect is Effect.DENY


def test_an_error_of_a_policy_names_it_and_the_error():
    class Broken:
        id = "TEA-1"

        def judge(self, case):
            raise ZeroDivisionError

    decision = answer(KNOWN, policy("broken", Effect.PERMIT, Check(Broken())))
    assert (decision.effect, decision.reason, decision.primitive) == (Effect.DENY, Reason.POLICY_ERROR, "")
    assert decision.findings[0].detail == {
        "policy": "broken",
        "error": "ZeroDivisionError",
        "remedy": REASONS[Reason.POLICY_ERROR].remedy,
    }


def test_a_set_in_which_nothing_may_permit_denies():
    for policies in ((), (policy("other", Effect.DEFER, Always()),)):
        decision = answer(*policies)
        assert (decision.effect, decision.reason, decision.primitive) == (Effect.DENY, Reason.NO_POLICY, "")


class Open:
    """An impact gate that lets everything through, so that the PITBound is seen alone."""

    id = "TEA-4"

    def judge(self, case):
        return Holds()


LEAVE = {"evidence.opening": world.OPENING}


@pytest.mark.parametrize(
    ("given", "effect", "reason", "detail"),
    [
        ({"evidence.impact": "not collected"}, Effect.DENY, Reason.EVIDENCE_MISSING, {"evidence": "impact"}),
        ({"evidence.impact.tier": 2}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL, {"tier": 2}),
        ({"evidence.impact.tier": 3}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL, {"tier": 3}),
        ({"evidence.impact.tier": 4}, Effect.DENY, Reason.TIER_SAFETY_CRITICAL, {"tier": 4}),
        ({"evidence.impact.tier": 4} | LEAVE, Effect.DEFER, Reason.TIER_SAFETY_CRITICAL, {"tier": 4}),
    ],
)
def test_what_a_pit_bound_says(given, effect, reason, detail):
    bound = policy("bound", Effect.PERMIT, Check(Open()), pit_bound=Tier.CONSEQUENTIAL)
    decision = decide(*world.asked(given), PolicySet("set", 1, (bound,), Parameters()))
    whole = detail if "tier" not in detail else {**detail, "pit_bound": 2, "policy": "bound"}
    assert (decision.effect, decision.reason, decision.primitive) == (effect, reason, "TEA-4")
    assert [finding.detail for finding in decision.findings] == [{**whole, "remedy": REASONS[reason].remedy}]


@pytest.mark.parametrize(
    ("name", "bounds"),
    [
        ("CII-5", {"unvouched_max_tier": 3, "agent_max_tier": 2, "recorded_max_tier": 4}),
        ("CII-5", {"agent_max_tier": 3, "recorded_max_tier": 2}),
        ("AID-2", {"sponsor_age_tier_0_s": 86_399}),
        ("AID-2", {"sponsor_age_tier_1_s": 899, "sponsor_age_tier_2_s": 900}),
        ("AID-2", {"sponsor_age_tier_2_s": 3_599, "sponsor_age_tier_3_s": 3_600}),
        ("AID-2", {"sponsor_age_tier_3_s": 900, "sponsor_age_tier_4_s": 901}),
    ],
)
def test_bounds_that_favour_the_worse_case_do_not_exist(name, bounds):
    defaults = {row.name: row.default for row in ROWS[name].parameters}
    with pytest.raises(PolicyError) as error:
        ROWS[name].make(**{**defaults, **bounds})
    assert (error.value.code, error.value.where) == (PolicyFault.NOT_MONOTONE, "primitive")


@pytest.mark.parametrize(
    ("name", "bounds"),
    [
        ("CII-5", {"unvouched_max_tier": 2, "agent_max_tier": 2, "recorded_max_tier": 2}),
        ("AID-2", {f"sponsor_age_tier_{tier}_s": 900 for tier in (1, 2, 3, 4)}),
    ],
)
def test_bounds_that_favour_neither_exist(name, bounds):
    defaults = {row.name: row.default for row in ROWS[name].parameters}
    assert ROWS[name].make(**{**defaults, **bounds}).id == name

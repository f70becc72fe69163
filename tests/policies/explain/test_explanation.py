"""An explanation says what `decide` said, and shows every policy and primitive on the way."""

import random
from dataclasses import replace

import pytest
from capabilities.values.scope import Tier
from policies.decision.combine import checks
from policies.decision.policy import Concern
from policies.explain.explanation import explain
from tests.model import triples
from tests.policies import world
from tests.policies.decision.test_load import GOOD, but

from policies import NOT_COLLECTED, Effect, Evidence, decide, load, load_shipped

SET = load_shipped("paper-default")


def leaves(asked):
    return [asked] if not asked.parts else [leaf for part in asked.parts for leaf in leaves(part)]


def test_the_decision_is_the_one_of_decide_and_the_parts_give_it():
    for seed in range(600):
        request, evidence, policies = triples.triple(random.Random(seed).choice)
        found = explain(request, evidence, policies)
        assert found.decision == decide(request, evidence, policies), seed
        assert [said.policy for said in found.said] == list(policies.policies)
        effects = {said.effect for said in found.said}
        if Effect.DENY in effects:
            assert found.decision.effect is Effect.DENY, seed
        if found.decision.effect is Effect.PERMIT and found.decision.approval is None:
            assert effects <= {Effect.PERMIT, None}, seed
        for said in found.said:
            assert (said.effect is None) or (said.concern is not Concern.NO), seed
            meant = {part.meant for part in said.parts}
            assert said.concern is next(c for c in (Concern.NO, Concern.UNKNOWN, Concern.YES) if c in meant), seed
            if said.predicate is not None:
                asked = [leaf.what for leaf in leaves(said.predicate) if leaf.what != "always"]
                assert asked == [primitive.id for primitive, _ in checks(said.policy.predicate)], seed


def test_each_primitive_shows_its_verdict_finding_and_parameters():
    request, evidence = world.asked({"evidence.trust.score_permille": 650, "evidence.impact.tier": 2})
    found = explain(request, evidence, SET)
    impact = next(said for said in found.said if said.policy.id == "impact")
    trust = next(leaf for leaf in leaves(impact.predicate) if leaf.what == "CATP-3")
    assert (trust.verdict, trust.parameters) == ("defers", (("trust_theta_permille", 700),))
    assert [f.reason for f in trust.findings] == ["TRUST_TOO_LOW"]
    assert (impact.effect, found.decision.reason) == (Effect.DEFER, "TRUST_TOO_LOW")
    assert impact.predicate.verdict == "defers"
    assert found.text
    assert found.remedy


@pytest.mark.parametrize(
    ("changes", "part", "meant"),
    [
        ({"request.points": ["e1"]}, "point", Concern.NO),
        ({"request.object": "ur5e"}, "object", Concern.NO),
        ({"request.operation": "stop"}, "operation", Concern.NO),
        ({"evidence.chain": "not collected"}, "agent", Concern.UNKNOWN),
        ({}, "sponsor", Concern.YES),
    ],
)
def test_why_a_policy_concerns_a_request_is_said_part_for_part(changes, part, meant):
    text = but('agents = "any"', 'agents = ["robotic"]').replace(
        'ids = "any", operations = "any"', 'ids = ["ur3e"], operations = "any", without = ["stop"]'
    )
    (said,) = explain(*world.asked(changes), load(text)).said
    assert {p.what: p.meant for p in said.parts}[part] is meant
    assert said.concern is (Concern.YES if meant is Concern.YES else meant)
    if meant is Concern.NO:
        assert (said.effect, said.predicate) == (None, None)


def test_a_stranger_is_denied_by_a_policy_that_names_agents():
    text = but('agents = "any"', 'agents = ["robotic"]')
    (said,) = explain(*world.asked({"evidence.chain": {"fault": "REVOKED"}}), load(text)).said
    assert (said.concern, said.effect, said.predicate) == (Concern.UNKNOWN, Effect.DENY, None)
    assert [f.reason for f in said.findings] == ["REVOKED"]


def test_what_people_answered_is_part_of_how_it_combines():
    request, evidence, policies = world.approved(3)
    found = explain(request, evidence, policies)
    assert found.decision.effect is Effect.PERMIT
    assert any(evidence.approval.ask_id in step for step in found.combined)
    waiting = explain(request, replace(evidence, approval=None), policies)
    assert waiting.decision.effect is Effect.DEFER
    assert waiting.decision.tier is Tier.HIGH_CONSEQUENCE


def test_evidence_that_is_broken_is_explained_without_policies():
    request, _ = world.asked()
    found = explain(request, Evidence(at="now", at_ms=5), SET)
    assert (found.decision.effect, found.said) == (Effect.DENY, ())


def test_nothing_collected_is_explained():
    request, _ = world.asked()
    found = explain(request, Evidence(at=0.0, at_ms=0), SET)
    assert found.decision.effect is Effect.DENY
    assert {said.effect for said in found.said if said.concern is Concern.YES} == {Effect.DENY}
    assert Evidence(at=0.0, at_ms=0).chain is NOT_COLLECTED


def test_where_no_policy_may_permit_that_is_said():
    text = (
        GOOD.replace('"PERMIT"', '"DENY"')
        .replace('{ all = ["AID-1", "TEA-1"] }', '"always"')
        .replace('"e4", "e5"', '"e1"')
    )
    found = explain(*world.asked(), load(text))
    assert found.decision.reason == "NO_POLICY"
    assert "DENY" in found.combined[0]

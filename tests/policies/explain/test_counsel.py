"""Remedies: each suggestion that can be checked is, and the check is the decision itself."""

import dataclasses
import random
from importlib import resources

import pytest
from policies.explain.remedies import _changes
from policies.words.reason_table import REASONS
from tests.model import triples
from tests.policies import world

from policies import Effect, Means, Reason, decide, load, load_shipped, remedies
from policies.words import canonical

TEXT = resources.files("policies").joinpath("sets", "paper-default.toml").read_text("utf-8")
HEAD = TEXT[: TEXT.index("[parameters]")]
SET = load(
    HEAD
    + "".join(
        f'''
[[policy]]
id = "{name}"
subject = {{ agents = "any", sponsors = "any" }}
object = {{ ids = "any", operations = "any" }}
predicate = {{ all = {primitives} }}
ep = ["{point}"]
effect = "PERMIT"
obligation = ["record"]
pit_bound = {bound}
'''
        for name, point, bound, primitives in (
            ("authority", "e4", '"none"', '["AID-1", "AID-2", "AID-3", "AID-4", "AID-5", "CATP-2", "CATP-4"]'),
            ("scope", "e4", '"none"', '["TEA-1", "TEA-2", "TEA-3"]'),
            ("robot", "e5", '"none"', '["TEA-5", "CII-4"]'),
            ("impact", "e4", "3", '["TEA-4", "CATP-3"]'),
        )
    )
)
"""Those primitives whose reasons are told here, and no others that would have something to say besides."""
WHOLE = load_shipped("paper-default")
LIMIT = {
    "refusal": "LIMIT_EXCEEDED_BY_REQUEST", "parameter": "speed", "unit": "urad_s", "value": 2_000_000,
    "bound": {"low": 0, "high": 1_000_000}, "nearest": 1_000_000, "hop": 1,
}  # fmt: skip
TIER_3 = {"evidence.impact.tier": 3, "evidence.impact.index_milli": 2_500}
TIER_4 = {
    "evidence.impact.tier": 4, "evidence.impact.index_milli": 3_500,
    "evidence.chain.hops.0.ceiling": 4, "evidence.chain.hops.1.ceiling": 4,
}  # fmt: skip


def told(given=None, policies=SET):
    request, evidence = world.asked(given)
    return remedies(request, evidence, policies, decide(request, evidence, policies))


def short(given):
    return [(r.means, r.lifts, r.effect) for r in told(given)]


def test_a_permit_needs_no_remedy():
    assert told() == ()


def test_the_speed_at_which_nobody_need_be_asked_and_the_people_who_could_be():
    slower, people = told({**TIER_3, "evidence.impact.lower_tier_speed": 312_000})
    assert (slower.means, slower.effect, slower.remains) == (Means.PARAMETER, Effect.PERMIT, ())
    assert slower.detail == {"parameter": "speed", "unit": "urad_s", "at_most": 312_000, "tier": 2}
    assert (people.means, people.effect) == (Means.APPROVAL, Effect.PERMIT)
    assert people.detail == {"people": 1, "prior_leave": False}


def test_one_suggestion_for_two_reasons_is_told_once():
    found = told({**TIER_3, "evidence.impact.lower_tier_speed": 312_000}, WHOLE)
    assert [(r.means, r.lifts) for r in found] == [
        (means, (Reason.TIER_NEEDS_APPROVAL, Reason.SEQUENCE_NEEDS_APPROVAL)) for means in (Means.PARAMETER, Means.APPROVAL)
    ]  # fmt: skip
    assert [r.effect for r in found] == [Effect.PERMIT, Effect.PERMIT]


def test_a_lower_speed_that_does_not_suffice_says_what_remains():
    given = {**TIER_3, "evidence.impact.lower_tier_speed": 312_000, "evidence.trust.score_permille": 600}
    slower = told(given)[0]
    assert (slower.effect, slower.remains) == (Effect.DEFER, (Reason.TRUST_TOO_LOW,))


@pytest.mark.parametrize("speed", [None, 0, -1, 10**9])
def test_a_speed_that_is_no_lower_one_is_not_suggested(speed):
    given = {**TIER_3, "evidence.impact.lower_tier_speed": "none" if speed is None else speed}
    assert [r.means for r in told(given)] == [Means.APPROVAL]


def test_tier_4_wants_two_people_and_prior_leave():
    (people,) = told(TIER_4)
    assert people.detail == {"people": 2, "prior_leave": True}
    assert people.effect is Effect.PERMIT


def test_people_may_not_approve_what_is_too_fast():
    (people,) = told({**TIER_3, "evidence.impact.tcp_speed_um_s": 250_001})
    assert (people.effect, people.remains[0]) == (Effect.DENY, Reason.APPROVED_TOO_FAST)


def test_a_parameter_over_its_limit_goes_to_the_nearest_value_and_its_physics_is_not_known():
    (nearest,) = told({"evidence.request_fault": LIMIT})
    assert nearest.means is Means.PARAMETER
    assert nearest.detail == {"parameters": [{"parameter": "speed", "unit": "urad_s", "nearest": 1_000_000}]}
    assert (nearest.effect, nearest.remains) == (None, (Reason.EVIDENCE_MISSING,))


def test_every_parameter_that_is_outside_is_found_by_asking_the_scope_again():
    request, evidence = world.asked({"evidence.request_fault": {**LIMIT, "parameter": "q0", "nearest": 3_000_000}})
    request = dataclasses.replace(
        request, values=tuple(dataclasses.replace(v, value=9_000_000) for v in request.values)
    )
    (nearest,) = remedies(request, evidence, SET, decide(request, evidence, SET))
    assert [(p["parameter"], p["nearest"]) for p in nearest.detail["parameters"]] == [("q0", 3_000_000), ("speed", 1_000_000)]  # fmt: skip


ALONE = {
    "PROOF_STALE": ({"evidence.proof": {"fault": "PROOF_STALE"}}, Means.PROOF, Effect.PERMIT),
    "REPLAYED": ({"evidence.proof": {"fault": "REPLAYED"}}, Means.PROOF, Effect.PERMIT),
    "EXPIRED": ({"evidence.chain.hops.1.not_after": 1_000_000}, Means.TOKEN, Effect.PERMIT),
    "EXPIRED for good": ({"evidence.chain": {"fault": "EXPIRED"}}, Means.TOKEN, None),
    "NOT_YET_VALID": ({"evidence.chain.hops.1.not_before": 1_000_001}, Means.TOKEN, Effect.PERMIT),
    "WRONG_AUDIENCE": ({"evidence.chain.hops.1.audiences": ["x"]}, Means.TOKEN, Effect.PERMIT),
    "NOT_GRANTED": ({"evidence.request_fault": {"refusal": "NOT_GRANTED"}}, Means.TOKEN, Effect.PERMIT),
    "NOT_NARROWER": ({"evidence.chain": {"fault": "NOT_NARROWER"}}, Means.TOKEN, None),
    "ATTESTATION_OLD": ({"evidence.chain.hops.0.attested_at": 990_000}, Means.ATTESTATION, Effect.PERMIT),
    "SPONSOR_AUTHENTICATION_OLD": ({"evidence.chain.sponsor.authenticated_at": 900_000}, Means.LOGIN, Effect.PERMIT),
    "REVOCATION_VIEW_STALE": ({"evidence.chain.view_age_ms": 9_999}, Means.NEWS, Effect.PERMIT),
    "ROBOT_NOT_RUNNING": ({"evidence.robot.robot_mode": 5}, Means.ROBOT, Effect.PERMIT),
    "TOOL_DEFINITION_CHANGED": ({"evidence.tool.actual_digest": "ff" * 32}, Means.TOOL, Effect.PERMIT),
    "PHYSICS_VIOLATION": ({"evidence.impact.violations": ["zone"]}, Means.NOTHING, Effect.DENY),
    "ABOVE_CEILING": ({**TIER_3, "evidence.chain.hops.1.ceiling": 2}, Means.NOTHING, Effect.DENY),
    "REVOKED": ({"evidence.chain": {"fault": "REVOKED"}}, Means.NOTHING, Effect.DENY),
    "PERCEPTION_INVALID": ({"evidence.impact": {"fault": "PERCEPTION_INVALID"}}, Means.NOTHING, Effect.DENY),
}


@pytest.mark.parametrize("name", ALONE)
def test_one_thing_that_is_wrong_and_what_would_change_it(name):
    given, means, effect = ALONE[name]
    first = told(given)[0]
    assert (first.lifts, first.means, first.effect) == ((Reason(name.split(" ")[0]),), means, effect)
    if means is Means.NOTHING:
        assert first.detail == {"instead": REASONS[first.lifts[0]].remedy}


def test_an_unseen_cell_waits_for_its_sensors_or_asks_people():
    given = {"evidence.impact.perception": "stale", "evidence.perception.sensors": [{"sensor": "camera-1", "state": "stale", "fault": "", "age_ms": 900}]}  # fmt: skip
    found = {r.detail.get("of"): r.effect for r in told(given) if r.means is Means.NEWS}
    assert found == {"sensors": Effect.PERMIT}


def test_several_things_are_needed_together_and_none_is_enough_alone():
    found = told({"evidence.chain.view_age_ms": 9_999, "evidence.proof": {"fault": "PROOF_STALE"}, **TIER_3})
    *alone, together = found
    assert {r.means for r in alone} == {Means.NEWS, Means.PROOF, Means.APPROVAL}
    assert all(r.effect is not Effect.PERMIT for r in alone)
    assert (together.means, together.effect, together.remains) == (Means.ALL, Effect.PERMIT, ())
    assert together.detail["means"][-1] == "approval", "people are asked last, about what the others made of it"


def test_what_cannot_be_supposed_makes_all_of_it_unknown():
    found = told({"evidence.request_fault": {"fault": "TOKEN_MISSING"}, "evidence.proof": {"fault": "PROOF_STALE"}})
    assert found[-1].means is Means.ALL
    assert found[-1].effect is None


@pytest.mark.parametrize("broken", [{"at": float("nan")}, {"chain": 7}, {"impact": "x"}])
def test_what_has_no_shape_has_no_remedy(broken):
    request, evidence = world.asked()
    strange = dataclasses.replace(evidence, **broken)
    (nothing,) = remedies(request, strange, SET, decide(request, strange, SET))
    assert (nothing.means, nothing.effect) == (Means.NOTHING, Effect.DENY)


@pytest.mark.long
def test_every_suggestion_on_random_cases_is_what_decide_says_of_the_changed_case():
    """And each reason of a refusal has a suggestion, or a word that there is none."""
    pick, permitted, seen = random.Random(12).choice, 0, set()
    for _ in range(1_500):
        request, evidence, policies = triples.triple(pick)
        decision = decide(request, evidence, policies)
        found = remedies(request, evidence, policies, decision)
        seen.update(r.means for r in found)
        if decision.effect is Effect.PERMIT:
            assert found == ()
            continue
        reasons = {f.reason for f in decision.findings}
        assert {reason for r in found for reason in r.lifts} == (reasons - {Reason.EVIDENCE_MISSING} or reasons)
        changed = [
            then
            for finding in decision.findings
            for change in _changes(finding, request, evidence, policies)
            if change.suppose is not None
            for then in [decide(*change.suppose(request, evidence), policies)]
        ]
        for remedy in found:
            canonical.text(remedy)
            if remedy.effect is Effect.PERMIT:
                assert remedy.remains == ()
                permitted += 1
                assert remedy.means is Means.ALL or any(then.effect is Effect.PERMIT for then in changed)
            elif remedy.effect is not None:
                assert remedy.remains
        assert found == remedies(request, evidence, policies, decision)
    assert permitted > 50
    assert seen >= {Means.PARAMETER, Means.PROOF, Means.TOKEN, Means.APPROVAL, Means.NOTHING, Means.ALL, Means.LOGIN}


def test_a_supposition_leaves_the_case_as_it_was():
    request, evidence = world.asked({**TIER_4, "evidence.chain.view_age_ms": 9_999})
    before = evidence.digest, request.digest
    remedies(request, evidence, SET, decide(request, evidence, SET))
    assert (evidence.digest, request.digest) == before
    assert evidence.opening is None

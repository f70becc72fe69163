"""Answers of the shipped set, story by story."""

import dataclasses

import pytest
from capabilities.values.scope import Tier
from tests.policies import world

from policies import (
    NOT_COLLECTED,
    Effect,
    ObligationKind,
    PolicySet,
    Reason,
    Requirement,
    TrustReading,
    chain_trust,
    decide,
    load_shipped,
    requirement,
)

SET = load_shipped("paper-default")


def answer(given=None, policies=SET):
    return decide(*world.asked(given), policies)


def led(decision):
    return decision.effect, decision.reason, decision.primitive


def test_c0_is_permitted_recorded_watched_and_no_faster():
    decision = answer()
    assert led(decision) == (Effect.PERMIT, Reason.PERMITTED, "")
    assert decision.findings == ()
    assert (decision.tier, decision.index) == (Tier.REVERSIBLE, 1_000)
    assert [o.kind for o in decision.obligations] == [ObligationKind.CLAMP, ObligationKind.RECORD, ObligationKind.WATCH]
    assert decision.lifetime_ms == 50


def test_c1_is_permitted_at_theta_and_deferred_below():
    c1 = {"evidence.impact.tier": 2, "evidence.impact.index_milli": 1_940}
    assert led(answer({**c1, "evidence.trust.score_permille": 700}))[0] is Effect.PERMIT
    below = answer({**c1, "evidence.trust.score_permille": 699})
    assert led(below) == (Effect.DEFER, Reason.TRUST_TOO_LOW, "CATP-3")
    assert below.tier is Tier.CONSEQUENTIAL
    assert below.lifetime_ms == 0


def test_c2_is_deferred():
    decision = answer({"evidence.impact.tier": 3, "evidence.impact.index_milli": 2_870})
    assert led(decision) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL, "TEA-4")


def test_c2_under_a_ceiling_of_two_is_denied_and_asks_nobody():
    decision = answer(
        {"evidence.impact.tier": 3, "evidence.chain.hops.1.ceiling": 2, "evidence.trust.score_permille": 0}
    )
    assert led(decision) == (Effect.DENY, Reason.ABOVE_CEILING, "TEA-4")
    assert decision.findings[0].detail["set_by"]["agent"] == "robotic"


def test_a_path_through_a_person_is_a_violation_before_it_is_anything_else():
    decision = answer(
        {"evidence.impact.tier": 4, "evidence.impact.violations": ["person"], "evidence.chain.hops.1.ceiling": 2}
    )
    assert led(decision) == (Effect.DENY, Reason.PHYSICS_VIOLATION, "TEA-4")
    assert Reason.ABOVE_CEILING in {f.reason for f in decision.findings}


def test_tier_four_is_denied():
    decision = answer({"evidence.impact.tier": 4, "evidence.chain.hops.1.ceiling": 4})
    assert led(decision) == (Effect.DENY, Reason.TIER_SAFETY_CRITICAL, "TEA-4")


@pytest.mark.parametrize("reason", ["NOT_FINITE", "PHYSICS_FAULT", "PERCEPTION_INVALID", "ENGINES_DISAGREE"])
def test_a_fault_of_physics_is_denied_and_has_no_tier(reason):
    decision = answer({"evidence.impact": {"fault": reason}})
    assert led(decision) == (Effect.DENY, Reason(reason), "TEA-4")
    assert (decision.tier, decision.index) == (None, None)


@pytest.mark.parametrize(
    ("code", "detail", "owners"),
    [
        ("SIGNATURE_INVALID", "", ["AID-3"]),
        ("NOT_NARROWER", "", ["CATP-2", "AID-4"]),
        ("HOP_NOT_ATTESTED", "", ["CATP-4"]),
        ("EXPIRED", "", ["AID-3"]),
        ("REVOKED", "sponsor:alice", ["AID-2"]),
        ("REVOKED", "token:t", ["AID-3"]),
        ("TOO_MANY_HOPS", "", ["AID-5"]),
        ("TOKEN_TOO_LARGE", "", ["AID-5"]),
        ("WRONG_AUDIENCE", "", ["AID-5"]),
        ("TOKEN_MISSING", "", ["AID-1"]),
    ],
)
def test_a_fault_of_the_chain_leads_with_its_reason_and_its_owners(code, detail, owners):
    given = {"evidence.chain": {"fault": code, "detail": detail}}
    given |= {
        f"evidence.{part}": "not collected"
        for part in ("proof", "request_fault", "robot_fault", "tool", "trust", "impact")
    }
    decision = answer(given)
    assert led(decision) == (Effect.DENY, Reason(code), owners[0])
    assert [f.primitive for f in decision.findings if f.reason == code] == owners
    assert decision.tier is None


def test_a_stolen_token_is_denied_by_its_proof_although_nothing_else_was_collected():
    given = {
        f"evidence.{part}": "not collected" for part in ("request_fault", "robot_fault", "tool", "trust", "impact")
    }
    decision = answer({**given, "evidence.proof": {"fault": "PROOF_WRONG_KEY"}})
    assert led(decision) == (Effect.DENY, Reason.PROOF_WRONG_KEY, "AID-1")


def test_a_limit_leads_although_physics_was_not_computed():
    given = {
        "evidence.impact": "not collected",
        "evidence.trust": "not collected",
        "evidence.robot_fault": "not collected",
    }
    decision = answer(
        {**given, "evidence.request_fault": {"refusal": "LIMIT_EXCEEDED_BY_REQUEST", "parameter": "speed"}}
    )
    assert led(decision) == (Effect.DENY, Reason.LIMIT_EXCEEDED_BY_REQUEST, "TEA-2")
    assert decision.findings[0].detail["parameter"] == "speed"


def test_an_operation_without_grant_leads_with_that():
    decision = answer(
        {
            "request.operation": "gripper_move",
            "evidence.request_fault": {"refusal": "NOT_GRANTED"},
            "evidence.impact": "not collected",
        }
    )
    assert led(decision) == (Effect.DENY, Reason.NOT_GRANTED, "TEA-1")


def test_reading_needs_no_physics_and_may_use_the_longer_lease():
    given = {
        "request.operation": "read_state",
        "evidence.impact": "not collected",
        "evidence.tool.base_tier": 0,
        "evidence.trust": "not collected",
    }
    assert led(answer({**given, "evidence.chain.view_age_ms": 30_000}))[0] is Effect.PERMIT
    assert led(answer({**given, "evidence.chain.view_age_ms": 30_001})) == (
        Effect.DENY,
        Reason.REVOCATION_VIEW_STALE,
        "AID-3",
    )
    assert answer(given).tier is Tier.NO_EFFECT
    assert [o.kind for o in answer(given).obligations] == [ObligationKind.RECORD]


def test_motion_on_a_stale_view_is_denied_while_reading_goes_on():
    assert led(answer({"evidence.chain.view_age_ms": 2_001})) == (Effect.DENY, Reason.REVOCATION_VIEW_STALE, "AID-3")


STOP = {"request.operation": "stop", "evidence.tool.base_tier": 0}


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"evidence.trust.score_permille": 0},
        {"evidence.trust": "not collected"},
        {"evidence.chain.view_age_ms": 30_000},
        {"evidence.impact": {"fault": "PHYSICS_FAULT"}},
        {"evidence.impact": {"fault": "PERCEPTION_INVALID"}},
        {"evidence.impact": "not collected"},
        {"evidence.impact.tier": 4, "evidence.impact.violations": ["person"]},
        {"evidence.request_fault": {"refusal": "NOT_GRANTED"}},
        {"evidence.request_fault": "not collected"},
        {"evidence.robot_fault": "not collected"},
        {"evidence.tool.actual_digest": "changed"},
        {"evidence.tool": "not collected"},
        {"evidence.chain.sponsor.authenticated_at": 0},
        {"evidence.chain.hops.0.attested_at": 0},
        {"evidence.chain.hops.1.attested_at": 913_600},
        {"evidence.chain.hops.1.ceiling": 0},
    ],
)
def test_whoever_is_authenticated_may_stop(given):
    decision = answer({**STOP, **given})
    assert led(decision)[0] is Effect.PERMIT
    assert [o.kind for o in decision.obligations] == [ObligationKind.RECORD]


def test_a_stranger_is_not_authenticated():
    assert led(answer({**STOP, "evidence.proof": {"fault": "PROOF_WRONG_KEY"}})) == (
        Effect.DENY,
        Reason.PROOF_WRONG_KEY,
        "AID-1",
    )


def test_an_operation_that_nobody_thought_of_is_asked_for_its_physics():
    assert led(answer({"request.operation": "dance", "evidence.impact": "not collected"})) == (
        Effect.DENY,
        Reason.EVIDENCE_MISSING,
        "TEA-4",
    )


def test_what_a_gate_has_to_collect():
    request, _ = world.asked()
    assert requirement(request, SET) == Requirement(physical=True, lease_ms=2_000, lifetime_ms=50)
    for operation in ("read_state", "stop"):
        other = dataclasses.replace(request, operation=operation)
        assert requirement(other, SET) == Requirement(physical=False, lease_ms=30_000, lifetime_ms=1_000)
    assert requirement(request, PolicySet("empty", 1, (), SET.parameters)).physical


def test_a_point_without_policy_is_denied():
    assert led(answer({"request.points": ["e3"]})) == (Effect.DENY, Reason.NO_POLICY, "")


def test_an_empty_set_denies():
    assert led(answer(policies=PolicySet("empty", 1, (), SET.parameters))) == (Effect.DENY, Reason.NO_POLICY, "")


def test_nothing_collected_at_all_is_denied():
    request, evidence = world.asked()
    empty = dataclasses.replace(
        evidence,
        **dict.fromkeys(("chain", "proof", "request_fault", "robot_fault", "tool", "trust", "impact"), NOT_COLLECTED),
    )
    assert led(decide(request, empty, SET))[:2] == (Effect.DENY, Reason.EVIDENCE_MISSING)


@pytest.mark.parametrize(
    ("stated", "score"),
    [
        ([None], 800),
        ([1_000], 800),
        ([801], 800),
        ([800], 800),
        ([799], 799),
        ([None, 650, 900], 650),
        ([0], 0),
        ([1_001], 0),
        ([-1], 0),
        ([True], 0),
        ([700.0], 0),
        ([], 0),
    ],
)
def test_trust_is_the_weakest_edge_and_never_above_the_prior(stated, score):
    assert chain_trust(stated, SET.parameters) == TrustReading(score)


@pytest.mark.parametrize("operation", ["move_joint", "gripper_move", "dance"])
def test_nothing_moves_on_a_frame_that_must_not_be_believed(operation):
    forged = {"evidence.perception.sensors.0.state": "invalid", "evidence.perception.sensors.0.fault": "UNTRUSTED"}
    assert led(answer({"request.operation": operation, **forged})) == (Effect.DENY, Reason.PERCEPTION_INVALID, "CII-4")
    deferred = {"evidence.impact.tier": 3, "evidence.impact.perception": "stale"}
    assert led(answer({"request.operation": operation, **forged, **deferred}))[:2] == (
        Effect.DENY,
        Reason.PERCEPTION_INVALID,
    )


def test_nothing_moves_while_nobody_says_where_the_view_comes_from():
    assert led(answer({"evidence.perception": "not collected"})) == (Effect.DENY, Reason.EVIDENCE_MISSING, "CII-4")


def test_a_silent_sensor_is_left_to_people():
    late = {"evidence.perception.sensors.1.state": "stale", "evidence.impact.perception": "stale"}
    assert led(answer(late)) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL, "TEA-4")

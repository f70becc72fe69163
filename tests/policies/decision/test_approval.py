"""Effect of an approval on a decision: one member at a time, on the boundary and one step beyond it."""

from dataclasses import replace

import pytest
from capabilities.values.scope import Tier
from policies.decision.combine import Always, Check
from policies.decision.obligations import CONSUME
from policies.evidence.evidence import Contribution, ImpactFault, OpeningReading
from policies.evidence.model import ApprovalUse
from tests.policies import world

from policies import (
    ROWS,
    Effect,
    Object,
    Obligation,
    ObligationKind,
    Parameters,
    Point,
    Policy,
    PolicySet,
    Reason,
    Subject,
    decide,
)

PERSON = Contribution("person", 500, "wrist_3", "dave", 10, 20, 30)


def answer(tier=3, *, approval=None, impact=None, evidence=None):
    request, seen, policies = world.approved(tier, **(approval or {}))
    seen = replace(seen, impact=replace(seen.impact, **(impact or {})), **(evidence or {}))
    return decide(request, seen, policies)


@pytest.mark.parametrize("tier", [3, 4])
def test_one_that_counts_permits_once_and_says_what_it_consumes(tier):
    decision = answer(tier)
    assert (decision.effect, decision.reason, decision.tier) == (Effect.PERMIT, Reason.PERMITTED, Tier(tier))
    assert decision.approval == ApprovalUse("a5" * 16, 1)
    assert CONSUME in decision.obligations
    assert decision.lifetime_ms == 50


def test_an_act_that_needs_no_people_consumes_nothing():
    decision = answer(impact={"tier": Tier(1)})
    assert (decision.effect, decision.approval) == (Effect.PERMIT, None)
    assert CONSUME not in decision.obligations


START = (0, -1_000, 2_000, 0, 0, 0)
COUNTS = {
    "index 50 higher": ({}, {"index_milli": 2_550}),
    "index lower": ({}, {"index_milli": 2_001}),
    "start 2 mrad off": ({}, {"start_urad": (2_000, -2_000, 0, 0, 0, 0)}),
    "a contribution fewer": ({}, {"contributions": ()}),
    "known contributor elsewhere": (
        {"contributors": frozenset({("person", "dave"), ("parameter", "joint_speed")})},
        {"contributions": (PERSON,)},
    ),
    "at its last second": ({"not_after": 1_000_000}, {}),
    "word of 2 s ago": ({"age_ms": 2_000}, {}),
    "word of this very millisecond": ({"age_ms": 0}, {}),
    "at the approved speed": ({}, {"tcp_speed_um_s": 250_000, "contact_permille": 1_000}),
    "nobody need attest to a cell that is seen": ({"sees_clear": False}, {}),
    "the sponsor alone": ({"approvers": ("alice",)}, {}),
}


@pytest.mark.parametrize("name", COUNTS)
def test_what_counts(name):
    approval, impact = COUNTS[name]
    assert answer(approval=approval, impact=impact).effect is Effect.PERMIT


DIFFERS = {
    "state": ({"state": "withdrawn"}, {}),
    "index_milli": ({}, {"index_milli": 2_551}),
    "start_urad": ({}, {"start_urad": (2_001, 0, 0, 0, 0, 0)}),
    "start_urad down": ({}, {"start_urad": (0, 0, 0, 0, 0, -2_001)}),
    "start_urad missing": ({}, {"start_urad": ()}),
    "contributors": ({}, {"contributions": (PERSON,)}),
    "contributors of another kind": (
        {"contributors": frozenset({("rigid", "dave"), ("parameter", "joint_speed")})},
        {"contributions": (PERSON,)},
    ),
    "tier": ({"tier": Tier(2)}, {}),
    "tier higher": ({"tier": Tier(4), "opening_id": world.OPENING["opening_id"]}, {}),
    "model_digest": ({}, {"model_digest": "dd"}),
    "policy_digest": ({"policy_digest": "dd"}, {}),
    "sponsor": ({"sponsor": "bob"}, {}),
    "reasons": ({"reasons": frozenset({"TRUST_TOO_LOW"})}, {}),
    "not_after": ({"not_after": 999_999}, {}),
    "uses_left": ({"uses_left": 0}, {}),
    "age_ms": ({"age_ms": 2_001}, {}),
    "age_ms from the future": ({"age_ms": -1}, {}),
    "approvers": ({"approvers": ()}, {}),
    "sees_clear": (
        {"sees_clear": False, "reasons": frozenset({"TIER_NEEDS_APPROVAL", "PERCEPTION_MISSING"})},
        {"perception": "stale"},
    ),
    "reasons once it went stale": ({}, {"perception": "stale"}),
}


@pytest.mark.parametrize("name", DIFFERS)
def test_what_does_not_count_is_asked_again_and_says_what_differs(name):
    approval, impact = DIFFERS[name]
    decision = answer(approval=approval, impact=impact)
    assert (decision.effect, decision.reason, decision.approval) == (Effect.DEFER, Reason.APPROVAL_NOT_USABLE, None)
    detail = decision.findings[0].detail
    assert name.split()[0] in [difference["what"] for difference in detail["differs"]]
    assert detail["ask_id"] == "a5" * 16
    assert CONSUME not in decision.obligations


@pytest.mark.parametrize(
    ("approval", "impact", "what", "shown", "now"),
    [
        ({"state": "withdrawn"}, {}, "state", "granted", "withdrawn"),
        ({"sponsor": "bob"}, {}, "sponsor", "bob", "alice"),
        ({"uses_left": 0}, {}, "uses_left", 1, 0),
        ({"not_after": 999_999}, {}, "not_after", 999_999, 1_000_000.0),
        ({"age_ms": 2_001}, {}, "age_ms", 2_000, 2_001),
        ({"approvers": ()}, {}, "approvers", 1, 0),
        ({"reasons": frozenset({"B", "A"})}, {}, "reasons", ["A", "B"], ["SEQUENCE_NEEDS_APPROVAL", "TIER_NEEDS_APPROVAL"]),
        ({"tier": Tier(2)}, {}, "tier", 2, 3),
        ({}, {"model_digest": "dd"}, "model_digest", "cc", "dd"),
        ({}, {"index_milli": 2_551}, "index_milli", 2_500, 2_551),
        ({}, {"start_urad": (2_001, 0, 0, 0, 0, 0)}, "start_urad", [0] * 6, [2_001, 0, 0, 0, 0, 0]),
        ({"contributors": frozenset({("b", "y"), ("a", "x")})}, {}, "contributors", [["a", "x"], ["b", "y"]], [["parameter", "joint_speed"]]),
    ],
)  # fmt: skip
def test_what_differs_is_told_as_it_was_shown_and_as_it_is(approval, impact, what, shown, now):
    (told,) = (
        each for each in answer(approval=approval, impact=impact).findings[0].detail["differs"] if each["what"] == what
    )
    assert told == {"what": what, "shown": shown, "now": now}


FOUR = {
    "one of two": ({"approvers": ("bob",)}, "approvers"),
    "one twice": ({"approvers": ("bob", "bob")}, "approvers"),
    "the sponsor twice": ({"approvers": ("alice", "alice")}, "approvers"),
    "another opening": ({"opening_id": "0c" * 16}, "opening"),
    "no opening named": ({"opening_id": ""}, "opening"),
}


@pytest.mark.parametrize("name", FOUR)
def test_tier_4_wants_two_people_and_the_opening(name):
    approval, what = FOUR[name]
    decision = answer(4, approval=approval)
    assert (decision.effect, decision.reason) == (Effect.DEFER, Reason.APPROVAL_NOT_USABLE)
    assert what in [difference["what"] for difference in decision.findings[0].detail["differs"]]


@pytest.mark.parametrize("opening", [None, {"uses_left": 0}, {"not_after": 999_999}])
def test_tier_4_without_an_opening_in_force_is_denied_whoever_approved(opening):
    seen = None if opening is None else OpeningReading(**{**world.OPENING, **opening})
    decision = answer(4, evidence={"opening": seen})
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.TIER_SAFETY_CRITICAL)


def test_an_opening_on_old_word_does_not_count():
    decision = answer(4, evidence={"opening": OpeningReading(**{**world.OPENING, "age_ms": 2_001})})
    assert (decision.effect, decision.reason) == (Effect.DEFER, Reason.APPROVAL_NOT_USABLE)


def test_an_opening_alone_is_a_question():
    decision = answer(4, evidence={"approval": None})
    assert (decision.effect, decision.reason, decision.primitive) == (
        Effect.DEFER,
        Reason.TIER_SAFETY_CRITICAL,
        "TEA-4",
    )


@pytest.mark.parametrize(
    ("state", "effect", "reason"),
    [
        ("open", Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        ("denied", Effect.DENY, Reason.APPROVAL_DENIED),
        ("used", Effect.DEFER, Reason.APPROVAL_USED),
        ("expired", Effect.DEFER, Reason.APPROVAL_NOT_USABLE),
    ],
)
def test_states(state, effect, reason):
    decision = answer(approval={"state": state})
    assert (decision.effect, decision.reason) == (effect, reason)


@pytest.mark.parametrize("impact", [{"tcp_speed_um_s": 250_001}, {"contact_permille": 1_001}])
def test_too_fast_for_an_approved_act_is_denied_with_the_speed_that_needs_nobody(impact):
    decision = answer(impact={**impact, "lower_tier_speed": 120_000})
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.APPROVED_TOO_FAST)
    assert decision.findings[0].detail["nearest_permitted"] == 120_000


def test_a_world_that_differs_besides_does_not_make_a_question_of_what_is_too_fast():
    assert answer(impact={"tcp_speed_um_s": 250_001}).effect is Effect.DENY
    assert answer(impact={"tcp_speed_um_s": 250_001, "model_digest": "dd"}).effect is Effect.DENY


def test_too_fast_in_an_unseen_cell_at_tier_4():
    reasons = frozenset({"TIER_SAFETY_CRITICAL", "SEQUENCE_NEEDS_APPROVAL", "PERCEPTION_MISSING"})
    impact = {"perception": "stale", "tcp_speed_um_s": 250_001}
    assert answer(4, approval={"reasons": reasons}, impact=impact).reason is Reason.APPROVED_TOO_FAST
    assert answer(4, approval={"reasons": reasons}, impact={"perception": "stale"}).effect is Effect.PERMIT


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"impact": ImpactFault("PERCEPTION_INVALID")}, Reason.PERCEPTION_INVALID),
        ({"trust": "x"}, Reason.EVIDENCE_MALFORMED),
    ],
)
def test_no_fault_is_lifted(change, reason):
    request, seen, policies = world.approved(3)
    decision = decide(request, replace(seen, **change), policies)
    assert (decision.effect, decision.reason) == (Effect.DENY, reason)


def test_no_violation_and_no_ceiling_is_lifted():
    assert answer(impact={"violations": ("zone",)}).reason is Reason.PHYSICS_VIOLATION
    request, seen, policies = world.approved(3)
    low = replace(seen.chain, hops=(*seen.chain.hops[:1], replace(seen.chain.hops[1], scope=replace(seen.chain.hops[1].scope, ceiling=Tier(2)))))  # fmt: skip
    assert decide(request, replace(seen, chain=low), policies).reason is Reason.ABOVE_CEILING


def test_trust_below_theta_is_resolved_where_the_ask_listed_it():
    low = {"trust": replace(world.asked()[1].trust, score_permille=600)}
    assert answer(2, approval={"reasons": frozenset({"TRUST_TOO_LOW"})}, evidence=low).effect is Effect.PERMIT
    assert answer(2, evidence=low).reason is Reason.APPROVAL_NOT_USABLE


def test_a_question_about_a_safety_critical_act_without_physics_wants_an_opening_too():
    """Without an impact gate, a policy that asks people still cannot ask about tier 4 without prior leave."""
    points = frozenset({Point.TOOL, Point.ACTUATION})
    record = frozenset({Obligation(ObligationKind.RECORD)})
    known = Policy("known", Subject(), Object(), Check(ROWS["TEA-1"].make()), points, Effect.PERMIT, record, None)
    asked = Policy("asked", Subject(), Object(), Always(), points, Effect.DEFER, record, None)
    policies = PolicySet("set", 1, (known, asked), Parameters())
    request, seen, _ = world.approved(4)
    seen = replace(seen, tool=replace(seen.tool, base_tier=Tier(4)), approval=None)
    assert decide(request, seen, policies).effect is Effect.DEFER
    decision = decide(request, replace(seen, opening=None), policies)
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.TIER_SAFETY_CRITICAL)

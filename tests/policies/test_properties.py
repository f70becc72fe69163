"""Properties of every request, evidence and set: hypothesis chooses, `tests.model.triples` shapes."""

import dataclasses
import os
import pathlib
import random
import subprocess
import sys

import pytest
from capabilities.values.scope import Tier
from hypothesis import assume, given
from hypothesis import strategies as st
from policies.decision.combine import AllOf, Always, AnyOf, Check
from policies.evidence.evidence import PerceptionReading
from policies.evidence.tiers import FRESH
from policies.primitives.base import Holds
from policies.words import canonical
from tests.model import triples
from tests.policies import world

from policies import (
    NOT_COLLECTED,
    ROWS,
    ApprovalReading,
    Contribution,
    Decision,
    Effect,
    ImpactReading,
    Object,
    OpeningReading,
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

SEVERITY = {Effect.PERMIT: 0, Effect.DEFER: 1, Effect.DENY: 2}
SET = load_shipped("paper-default")


@st.composite
def cases(draw):
    pick = random.Random(draw(st.integers(0, 2**64))).choice
    return *triples.triple(pick), pick


def unasked(case):
    """Case before people were asked.

    An approval binds the very policies and tier, so a comparison of two of them starts here.
    """
    request, evidence, policies, pick = case
    return request, dataclasses.replace(evidence, approval=None), policies, pick


ANYTHING = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.binary(max_size=5), st.just(object()), st.just(NOT_COLLECTED), st.just(Tier(4)),
    st.lists(st.integers(), max_size=2), st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
)  # fmt: skip
NEEDED = ("chain", "proof", "request_fault", "robot_fault", "tool", "trust", "impact", "at", "at_ms")
READINGS = (*NEEDED, "perception", "robot", "approval", "opening")


@given(cases(), st.dictionaries(st.sampled_from(READINGS), ANYTHING, min_size=1))
def test_nonsense_in_evidence_never_raises(case, nonsense):
    request, evidence, policies, _ = case
    strange = dataclasses.replace(evidence, **nonsense)
    for one in (policies, SET):
        assert isinstance(decide(request, strange, one), Decision)


@given(st.sampled_from([n for n in NEEDED if n != "at_ms"]), ANYTHING)
def test_nonsense_in_place_of_a_needed_reading_is_never_permitted(name, nonsense):
    """In the ordinary motion, which is permitted: any one reading replaced by something of no kind that it can have."""
    legal = {"at": float, "proof": bool, "request_fault": type(None), "robot_fault": type(None)}
    if name == "at" and type(nonsense) in {int, float, bool, Tier}:
        nonsense = float("nan")
    if isinstance(nonsense, legal.get(name, ())) and name != "at":
        nonsense = 0.5
    request, evidence = world.asked()
    assert decide(request, evidence, SET).effect is Effect.PERMIT
    assert decide(request, dataclasses.replace(evidence, **{name: nonsense}), SET).effect is Effect.DENY


@pytest.mark.parametrize(
    "field",
    [
        f.name
        for f in dataclasses.fields(ImpactReading)
        if f.name in {"tier", "index_milli", "perception", "violations"}
    ],
)
@pytest.mark.parametrize("nonsense", [None, "x", float("nan"), float("inf"), -1, 10**30, object()])
def test_nonsense_inside_an_impact_is_never_permitted(field, nonsense):
    request, evidence = world.asked()
    strange = dataclasses.replace(evidence, impact=dataclasses.replace(evidence.impact, **{field: nonsense}))
    assert decide(request, strange, SET).effect is not Effect.PERMIT


@pytest.mark.parametrize("thing", [None, 7, "x", object(), []])
def test_what_is_no_request_evidence_or_set_is_denied(thing):
    request, evidence = world.asked()
    for arguments, place in (((thing, evidence, SET), "request"), ((request, thing, SET), "evidence")):
        decision = decide(*arguments)
        assert (decision.effect, decision.reason) == (Effect.DENY, Reason.EVIDENCE_MALFORMED)
        assert decision.findings[0].detail["place"] == place
    decision = decide(request, evidence, thing)
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.POLICY_ERROR)


@given(cases())
def test_the_order_of_policies_and_parts_does_not_matter(case):
    request, evidence, policies, pick = unasked(case)

    def shuffled(items):
        items = list(items)
        random.Random(pick(range(10_000))).shuffle(items)
        return tuple(items)

    def turned(predicate):
        match predicate:
            case AllOf(parts) | AnyOf(parts):
                return type(predicate)(shuffled(turned(part) for part in parts))
            case _:
                return predicate

    other = PolicySet(
        policies.name,
        policies.version,
        shuffled(dataclasses.replace(p, predicate=turned(p.predicate)) for p in policies.policies),
        policies.parameters,
    )
    mine, its = decide(request, evidence, policies), decide(request, evidence, other)
    assert dataclasses.replace(mine, policy_digest="") == dataclasses.replace(its, policy_digest="")


@given(cases())
def test_a_policy_written_twice_says_no_more(case):
    request, evidence, policies, _ = unasked(case)
    twice = PolicySet(
        "random",
        1,
        (*policies.policies, *(dataclasses.replace(p, id=p.id + "'") for p in policies.policies)),
        policies.parameters,
    )
    mine, its = decide(request, evidence, policies), decide(request, evidence, twice)
    assert (mine.effect, mine.reason, mine.tier) == (its.effect, its.reason, its.tier)


@given(cases(), st.sampled_from([Effect.DENY, Effect.DEFER]))
def test_adding_a_prohibition_or_question_never_makes_the_answer_milder(case, effect):
    request, evidence, policies, pick = unasked(case)
    points = pick([frozenset({p}) for p in ROWS["TEA-4"].points])
    predicate = pick([Always(), triples.negative(pick, points, 2)])
    added = Policy("added", Subject(), Object(), predicate, points, effect, frozenset({triples.RECORD}), None)
    more = PolicySet("random", 1, (*policies.policies, added), policies.parameters)
    assert SEVERITY[decide(request, evidence, more).effect] >= SEVERITY[decide(request, evidence, policies).effect]


@given(cases())
def test_raising_the_tier_never_makes_the_answer_milder(case):
    request, evidence, policies, pick = unasked(case)
    if not isinstance(evidence.impact, ImpactReading):
        evidence = dataclasses.replace(evidence, impact=triples.impact(pick))
    for one in (policies, SET):
        answers = [
            SEVERITY[
                decide(request, dataclasses.replace(evidence, impact=triples.raised(evidence.impact, t)), one).effect
            ]
            for t in Tier
        ]
        assert answers == sorted(answers)


@given(cases())
def test_raising_the_base_tier_never_makes_the_answer_milder(case):
    request, evidence, policies, _ = unasked(case)
    if evidence.tool is NOT_COLLECTED:
        return
    for one in (policies, SET):
        answers = [
            SEVERITY[
                decide(
                    request, dataclasses.replace(evidence, tool=dataclasses.replace(evidence.tool, base_tier=t)), one
                ).effect
            ]
            for t in Tier
        ]
        assert answers == sorted(answers)


def contradicts(evidence):
    """True where physics calls a view fresh that rests on no fresh sensor.

    CII-4 denies that, wherever it is told both.
    """
    impact, perception = evidence.impact, evidence.perception
    if not isinstance(impact, ImpactReading) or not isinstance(perception, PerceptionReading):
        return False
    return impact.perception == FRESH and {sensor.state for sensor in perception.sensors} != {FRESH}


@given(cases(), st.sampled_from(["chain", "proof", "request_fault", "robot_fault", "tool", "trust", "impact"]))
def test_knowing_less_never_makes_the_answer_milder(case, name):
    """But a contradiction between two readings goes with one of them, at a point that asks for no physics."""
    request, evidence, policies, _ = case
    assume(name != "impact" or not contradicts(evidence))
    less = dataclasses.replace(evidence, **{name: NOT_COLLECTED})
    for one in (policies, SET):
        assert SEVERITY[decide(request, less, one).effect] >= SEVERITY[decide(request, evidence, one).effect]


@given(cases())
def test_what_people_say_lifts_no_denial(case):
    """But tier 4's, and that one only to a question."""
    request, evidence, policies, _ = case
    with_all = decide(request, evidence, policies)
    unanswered = decide(request, dataclasses.replace(evidence, approval=None), policies)
    bare = decide(request, dataclasses.replace(evidence, approval=None, opening=None), policies)
    if unanswered.effect is Effect.DENY:
        assert with_all.effect is Effect.DENY
    if bare.effect is Effect.DENY and unanswered.effect is not Effect.DENY:
        assert (bare.reason, bare.tier) == (Reason.TIER_SAFETY_CRITICAL, Tier.SAFETY_CRITICAL)
        assert unanswered.effect is Effect.DEFER
    if with_all.effect is Effect.PERMIT and unanswered.effect is not Effect.PERMIT:
        assert unanswered.effect is Effect.DEFER
        assert with_all.approval is not None
        assert {str(f.reason) for f in unanswered.findings} <= evidence.approval.reasons


def worse(evidence):
    """The same case in a worse world, or with less of an approval: one step for each way."""
    impact, approval, opening = evidence.impact, evidence.approval, evidence.opening
    steps = []
    if isinstance(impact, ImpactReading):
        stranger = Contribution("person", 100, "wrist", "stranger", 1, 2, 3)
        steps += [
            {"impact": dataclasses.replace(impact, **change)}
            for change in (
                {"tier": Tier(min(4, impact.tier + 1))},
                {"tier": Tier.SAFETY_CRITICAL},
                {"index_milli": max(impact.index_milli + 51, 4_001 * (impact.index_milli < 0))},
                {"contributions": (*impact.contributions, stranger)},
                {"violations": ("person",)},
                {"tcp_speed_um_s": impact.tcp_speed_um_s + 250_001},
                {"contact_permille": impact.contact_permille + 1_001},
                {"model_digest": "other"},
            )
        ]
        sensors = getattr(evidence.perception, "sensors", ())
        if sensors and all(sensor.state == "fresh" for sensor in sensors):
            # Where the sensors are said to be otherwise, calling the view stale would mend a contradiction.
            steps.append({"impact": dataclasses.replace(impact, perception="stale")})
    if isinstance(approval, ApprovalReading):
        steps += [
            {"approval": dataclasses.replace(approval, **change)}
            for change in (
                {"state": "open"},
                {"reasons": frozenset()},
                {"approvers": approval.approvers[:1]},
                {"approvers": ()},
                {"uses_left": 0},
                {"not_after": 0},
                {"age_ms": max(approval.age_ms, 0) + 2_001},  # a negative age is worse than any
                {"sees_clear": False},
                {"policy_digest": "other"},
                {"sponsor": "somebody"},
                {"opening_id": "other"},
            )
        ]
    if isinstance(opening, OpeningReading):
        steps += [{"opening": dataclasses.replace(opening, **c)} for c in ({"uses_left": 0}, {"not_after": 0})]
    return [*steps, {"approval": None}, {"opening": None}]


@given(cases())
def test_less_of_an_approval_or_a_worse_world_never_permits_more(case):
    request, evidence, policies, _ = case
    before = decide(request, evidence, policies)
    if isinstance(evidence.approval, ApprovalReading) and before.tier is not None:
        if before.tier < evidence.approval.tier:
            return  # it was given for a worse world than this one
    if before.effect is Effect.PERMIT:
        return
    for change in worse(evidence):
        assert decide(request, dataclasses.replace(evidence, **change), policies).effect is not Effect.PERMIT, change


def test_each_member_of_an_approval_is_needed():
    """Every step to a worse world or a lesser approval takes the PERMIT away, in tier 3 and 4."""
    for tier in (Tier.HIGH_CONSEQUENCE, Tier.SAFETY_CRITICAL):
        request, evidence, policies = world.approved(tier)
        assert decide(request, evidence, policies).effect is Effect.PERMIT
        for change in worse(evidence):
            effect = decide(request, dataclasses.replace(evidence, **change), policies).effect
            ((name, value),) = change.items()
            harmless = (
                value == evidence.impact  # tier 4 cannot be raised
                or (tier == 3 and name == "opening")
                or (tier == 3 and name == "approval" and value is not None and value.opening_id == "other")
                or (tier == 3 and name == "approval" and value is not None and len(value.approvers) == 1)
                or (
                    name == "approval"
                    and value is not None
                    and not value.sees_clear
                    and value.uses_left == 1
                    and value.age_ms < 2_000
                    and value.state == "granted"
                    and value == dataclasses.replace(evidence.approval, sees_clear=False)
                )
                or (
                    tier == 4
                    and name == "impact"
                    and value
                    in {
                        dataclasses.replace(evidence.impact, tcp_speed_um_s=evidence.impact.tcp_speed_um_s + 250_001),
                        dataclasses.replace(evidence.impact, contact_permille=evidence.impact.contact_permille + 1_001),
                    }
                )
            )
            assert (effect is Effect.PERMIT) == harmless, (tier, change)


@given(cases())
def test_a_lower_pit_bound_never_makes_the_answer_milder(case):
    request, evidence, policies, _ = unasked(case)
    answers = []
    for bound in reversed(Tier):
        bounded = tuple(
            p if p.pit_bound is None else dataclasses.replace(p, pit_bound=bound) for p in policies.policies
        )
        answers.append(SEVERITY[decide(request, evidence, PolicySet("random", 1, bounded, policies.parameters)).effect])
    assert answers == sorted(answers)


@given(cases())
def test_every_refusal_has_exactly_one_leading_finding_with_its_remedy(case):
    request, evidence, policies, _ = case
    decision = decide(request, evidence, policies)
    if decision.effect is Effect.PERMIT:
        assert (decision.findings, decision.primitive) == ((), "")
        assert decision.lifetime_ms > 0
        return
    assert (decision.findings[0].primitive, decision.findings[0].reason) == (decision.primitive, decision.reason)
    assert len({(f.primitive, f.reason) for f in decision.findings}) == len(decision.findings)
    assert decision.lifetime_ms == 0
    for finding in decision.findings:
        assert finding.detail["remedy"]
        canonical.text(finding.detail)


class Broken:
    id = "TEA-2"

    def judge(self, case):
        raise RuntimeError


@pytest.mark.parametrize("effect", list(Effect))
def test_a_policy_that_errors_denies_whatever_its_effect(effect, monkeypatch):
    monkeypatch.setattr("policies.decision.policy.checks", lambda _: ())
    broken = Policy(
        "broken",
        Subject(),
        Object(),
        Check(Broken()),
        frozenset(ROWS["TEA-4"].points),
        effect,
        frozenset({triples.RECORD}),
        None,
    )
    request, evidence = world.asked()
    decision = decide(request, evidence, PolicySet("set", 1, (*SET.policies, broken), Parameters()))
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.POLICY_ERROR)
    assert decision.findings[0].detail["policy"] == "broken"


def test_a_policy_for_one_agent_does_not_speak_for_another():
    policies = tuple(dataclasses.replace(p, subject=Subject(frozenset({"vision"}))) for p in SET.policies)
    request, evidence = world.asked()
    decision = decide(request, evidence, PolicySet("set", 1, policies, Parameters()))
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.NO_POLICY)


def test_a_policy_for_one_sponsor_does_not_speak_for_another():
    for name, effect in (("alice", Effect.PERMIT), ("bob", Effect.DENY)):
        policies = tuple(dataclasses.replace(p, subject=Subject(None, frozenset({name}))) for p in SET.policies)
        assert decide(*world.asked(), PolicySet("set", 1, policies, Parameters())).effect is effect


def test_a_prohibition_for_one_agent_speaks_while_nobody_knows_who_calls():
    denied = Policy(
        "not-vision",
        Subject(frozenset({"vision"})),
        Object(),
        Always(),
        ROWS["TEA-4"].points,
        Effect.DENY,
        frozenset({triples.RECORD}),
        None,
    )
    policies = PolicySet("set", 1, (*SET.policies, denied), Parameters())
    assert decide(*world.asked(), policies).effect is Effect.PERMIT
    decision = decide(*world.asked({"evidence.chain": "not collected"}), policies)
    assert Reason.PROHIBITED in {f.reason for f in decision.findings}


def test_empty_connectives_do_not_exist():
    for connective in (AllOf, AnyOf):
        with pytest.raises(PolicyError) as error:
            connective(())
        assert error.value.code is PolicyFault.EMPTY


def test_a_set_with_an_id_twice_does_not_exist():
    with pytest.raises(PolicyError) as error:
        PolicySet("set", 1, (SET.policies[0], SET.policies[0]), Parameters())
    assert error.value.code is PolicyFault.DUPLICATE_ID


def test_a_reading_that_changes_changes_the_digest_of_the_evidence():
    request, evidence = world.asked()
    changes = {
        "evidence.at": 1_000_001.0, "evidence.at_ms": 1, "evidence.chain.view_age_ms": 251, "evidence.chain.epoch": 8, "evidence.chain.token_id": "B",
        "evidence.chain": {"fault": "EXPIRED"}, "evidence.proof": {"fault": "REPLAYED"}, "evidence.request_fault": {"refusal": "NOT_GRANTED"},
        "evidence.robot_fault": "not collected", "evidence.tool.actual_digest": "ab", "evidence.tool.base_tier": 2, "evidence.trust.score_permille": 799,
        "evidence.approval": "not collected", "evidence.opening": "not collected",
        "evidence.impact.tier": 2, "evidence.impact.index_milli": 1_001, "evidence.impact.violations": ["zone"], "evidence.impact": "not collected",
    }  # fmt: skip
    digests = {world.asked({path: value})[1].digest for path, value in changes.items()}
    assert len(digests) == len(changes)
    assert evidence.digest not in digests


def test_canonical_texts_of_different_values_differ():
    values = [
        None,
        True,
        1,
        1.0,
        "1",
        b"1",
        (1,),
        frozenset({1}),
        {1: 1},
        2**60,
        -(2**60),
        float("inf"),
        float("-inf"),
        -0.0,
        0.0,
        float("nan"),
        "\ud800",
        object,
    ]
    assert len({canonical.text(value) for value in values}) == len(values)


SCRIPT = """
import hashlib, random, sys
from policies import decide
from policies.words import canonical
from tests.model import triples
pick = random.Random(int(sys.argv[1])).choice
told = hashlib.sha256()
for _ in range(300):
    told.update(canonical.text(decide(triples.request(pick), triples.evidence(pick), triples.policy_set(pick))).encode())
print(told.hexdigest())
"""


@pytest.mark.long
def test_decisions_are_the_same_in_every_process_and_on_every_hash_seed():
    told = set()
    top = pathlib.Path(__file__).parents[2]
    for seed in ("0", "1", "4242", "random"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        run = subprocess.run(
            [sys.executable, "-c", SCRIPT, "7"],
            capture_output=True,
            text=True,
            env=environment,
            cwd=top,
            timeout=60,
            check=True,
        )
        told.add(run.stdout)
    assert len(told) == 1


def test_the_same_arguments_give_the_same_decision_again():
    pick = random.Random(3).choice
    for _ in range(200):
        request, evidence, policies = triples.request(pick), triples.evidence(pick), triples.policy_set(pick)
        assert canonical.text(decide(request, evidence, policies)) == canonical.text(
            decide(request, evidence, policies)
        )


class OpenGate:
    """An impact gate that lets everything through, so that the PITBound is seen alone."""

    id = "TEA-4"

    def judge(self, case):
        return Holds()


@pytest.mark.parametrize(
    ("given", "effect", "reason"),
    [
        ({"evidence.impact.tier": 1}, Effect.PERMIT, Reason.PERMITTED),
        ({"evidence.impact.tier": 2}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        ({"evidence.impact.tier": 3}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        ({"evidence.impact.tier": 4}, Effect.DENY, Reason.TIER_SAFETY_CRITICAL),
        ({"evidence.tool.base_tier": 2}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        ({"evidence.impact.perception": "stale"}, Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        ({"evidence.impact": "not collected"}, Effect.DENY, Reason.EVIDENCE_MISSING),
        ({"evidence.impact": {"fault": "PHYSICS_FAULT"}}, Effect.DENY, Reason.EVIDENCE_MISSING),
        ({"evidence.tool": "not collected"}, Effect.DENY, Reason.EVIDENCE_MISSING),
    ],
)
def test_the_pit_bound_holds_by_itself(given, effect, reason):
    policy = Policy(
        "bound",
        Subject(),
        Object(),
        Check(OpenGate()),
        ROWS["TEA-4"].points,
        Effect.PERMIT,
        frozenset({triples.RECORD}),
        Tier.CONSEQUENTIAL,
    )
    decision = decide(*world.asked(given), PolicySet("set", 1, (policy,), Parameters()))
    assert (decision.effect, decision.reason) == (effect, reason)

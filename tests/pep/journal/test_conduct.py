"""Conduct as an enforcement point knows it: the stricter of the told and the seen one, at once."""

import asyncio
from dataclasses import replace

import pytest
from capabilities.statements.conduct import AgentEntry, DeviationEntry
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Tier
from capabilities.values.units import Quantity, Unit
from pep.base.operations import MOVE_JOINT
from pep.base.ports import ConductWord
from pep.journal.conduct import near_permille
from policies.conduct.report import Edge
from policies.conduct.trust_changes import CHARGES
from policies.decision.load import load
from policies.evidence.conduct_readings import Feature
from policies.evidence.evidence import NOT_COLLECTED, Evidence
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import FailingJournal, Rig, full_scope, reading

PRIOR = 800
POLICIES = """
name = "test"
version = 1

[[policy]]
id = "act"
subject = { agents = "any", sponsors = "any" }
object = { ids = "any", operations = "any", without = ["read_state", "stop"] }
predicate = { all = ["AID-1", "AID-3", "TEA-1", "TEA-2", "TEA-4", "CATP-1", "ABG-1", "ABG-2", "ABG-3", "ABG-4"] }
ep = ["e5"]
effect = "PERMIT"
obligation = ["record"]
pit_bound = 3

[[policy]]
id = "look"
subject = { agents = "any", sponsors = "any" }
object = { ids = "any", operations = ["read_state"] }
predicate = "AID-1"
ep = ["e5"]
effect = "PERMIT"
obligation = ["record"]
pit_bound = "none"
"""


@pytest.fixture
def rig(tmp_path):
    made = Rig(tmp_path)
    made.policies = load(POLICIES)
    made.build()
    yield made
    made.gate.close()


def chain_of(rig, holder):
    found = rig.credentials(holder).chain
    assert isinstance(found, Chain)
    return found


def run(rig, call):
    return asyncio.run(rig.gate.run(call, rig.effect))


def evidence_of(rig):
    return rig.records("decision")[-1]["body"]["evidence"]


def told(agent="robotic", **changes):
    fields = dict(version=1, deviations=(), deviated_at=None, contracted=False, samples=0, restored_at=None)
    return AgentEntry(agent=agent, **(fields | changes))


# --- what the gate is given ------------------------------------------------------------------------------------------


def test_every_decision_rests_on_one_edge_for_each_hop_and_on_the_holders_behaviour(rig):
    rig.registry.word = ConductWord(40, {Edge("alice", "robotic"): 750}, {"robotic": told(samples=9)})
    answer = run(rig, rig.call(rig.agent()))
    assert answer.decision.effect is Effect.PERMIT
    seen = evidence_of(rig)
    assert seen["trust"]["score_permille"] == 750
    assert [(e["delegator"], e["delegate"], e["score_permille"]) for e in seen["trust"]["edges"]] == [
        ("alice", "robotic", 750)
    ]
    assert (seen["behaviour"]["agent"], seen["behaviour"]["samples"], seen["behaviour"]["age_ms"]) == ("robotic", 9, 40)


def test_an_edge_of_another_pair_is_no_edge_of_this_chain(rig):
    rig.registry.word = ConductWord(
        0, {Edge("alice", "vision"): 1, Edge("bob", "robotic"): 2}, {"vision": told("vision", contracted=True)}
    )
    run(rig, rig.call(rig.agent()))
    assert evidence_of(rig)["trust"]["score_permille"] == PRIOR
    assert evidence_of(rig)["behaviour"]["contracted"] is False


def test_what_is_stated_and_what_is_told_only_tighten(rig):
    holder = rig.agent()
    for stated, score, expected in ((None, 900, PRIOR), (500, 700, 500), (700, 500, 500), (1_000, 1_000, PRIOR)):
        rig.registry.trust = {} if stated is None else {"robotic": stated}
        rig.registry.word = ConductWord(0, {Edge("alice", "robotic"): score}, {})
        assert rig.gate.conduct.trust(chain_of(rig, holder), at=rig.clock.wall_s()).score_permille == expected


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        (ConductWord(5_001, {}, {}), "BEHAVIOUR_OLD"),
        (ConductWord(0, {}, {"robotic": told(contracted=True, deviated_at=1)}), "SCOPE_CONTRACTED"),
        (
            ConductWord(0, {}, {"robotic": told(deviations=(DeviationEntry("near boundary", 1, 2_000),))}),
            "BEHAVIOUR_DRIFTS",
        ),
    ],
    ids=["old", "contracted", "drifts"],
)
def test_what_is_told_is_decided_on(rig, word, reason):
    rig.registry.word = word
    answer = run(rig, rig.call(rig.agent()))
    assert (answer.decision.effect, str(answer.decision.reason)) == (Effect.DENY, reason)
    assert rig.sent == []


# --- what it saw itself ----------------------------------------------------------------------------------------------


def beyond(rig, holder):
    """A call for more speed than the holder was lent."""
    return rig.call(
        holder, arguments={"q_rad": [0.1, -1.2, 1.0, -1.1, -1.57, 0.0], "speed_rad_s": 1.04, "acceleration_rad_s2": 1.4}
    )


def slow(rig):
    """A holder with less speed than `beyond` asks for, and without the gripper."""
    scope = full_scope(rig.clock.wall_s(), speed_high=600_000)
    arm = tuple(grant for grant in scope.grants if grant.operation != "gripper_activate")
    return rig.agent(scope=replace(scope, grants=arm))


def test_what_it_saw_itself_counts_at_once(rig):
    holder = slow(rig)
    before = rig.gate.conduct.trust(chain_of(rig, holder), at=rig.clock.wall_s())
    assert before.score_permille == PRIOR
    # What one slip is charged (policies.conduct.trust_changes), in thousandths of a plain wrong, against a prior that weighs 20.
    slip = CHARGES[Reason.LIMIT_EXCEEDED_BY_REQUEST].milli / 1_000
    for slips in (1, 2, 3):
        expected = round(PRIOR * 20 / (20 + slips * slip))
        assert run(rig, beyond(rig, holder)).decision.effect is Effect.DENY
        assert rig.gate.conduct.trust(chain_of(rig, holder), at=rig.clock.wall_s()).score_permille == expected
    rig.registry.word = ConductWord(0, {Edge("alice", "robotic"): PRIOR - 1}, {})
    assert rig.gate.conduct.trust(chain_of(rig, holder), at=rig.clock.wall_s()).score_permille == expected
    rig.registry.word = ConductWord(0, {Edge("alice", "robotic"): 700}, {})
    assert rig.gate.conduct.trust(chain_of(rig, holder), at=rig.clock.wall_s()).score_permille == 700


def test_nobody_is_charged_for_what_a_stranger_sent(rig):
    holder = rig.agent()
    presented = rig.credentials(holder)
    run(rig, rig.call(holder, credentials=replace(presented, proof=False)))
    run(rig, rig.call(holder, credentials=replace(presented, token=b"", chain=Fault(FaultCode.REVOKED, "TOK-9"))))
    assert rig.gate.conduct.trust(chain_of(rig, holder), at=rig.clock.wall_s()).score_permille == PRIOR
    assert rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s()).samples == 0


def probe(rig, holder, times=60):
    """It asks for what it was never lent, again and again."""
    for _ in range(times):
        assert str(run(rig, rig.call(holder, "gripper_activate")).decision.reason) == "NOT_GRANTED"


def test_probing_contracts_before_anybody_has_heard_of_it(rig):
    holder = slow(rig)
    probe(rig, holder)
    own = rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s())
    assert own.contracted
    assert Feature.REFUSALS in {deviation.feature for deviation in own.deviations}
    answer = run(rig, rig.call(holder))
    assert answer.decision.effect is Effect.DENY
    assert {"SCOPE_CONTRACTED", "REATTESTATION_NEEDED"} <= {str(f.reason) for f in answer.decision.findings}


def test_both_are_joined(rig):
    holder = slow(rig)
    probe(rig, holder)
    own = rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s())
    theirs = (DeviationEntry("rate", 5, 3_000), DeviationEntry("refusals", 7, 1))
    rig.registry.word = ConductWord(0, {}, {"robotic": told(deviations=theirs, deviated_at=7, samples=500)})
    both = rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s())
    assert {d.feature for d in both.deviations} == {Feature.RATE, Feature.REFUSALS} | {
        d.feature for d in own.deviations
    }
    (refusals,) = (d for d in both.deviations if d.feature is Feature.REFUSALS)
    assert refusals.since == 7
    assert refusals.score_milli == max(d.score_milli for d in own.deviations if d.feature is Feature.REFUSALS)
    assert (both.contracted, both.deviated_at, both.samples) == (True, own.deviated_at, 500)


@pytest.mark.clause("STM-8")
def test_a_feature_of_a_later_version_contracts(rig):
    rig.registry.word = ConductWord(0, {}, {"robotic": told(deviations=(DeviationEntry("mood", 5, 1),), deviated_at=5)})
    found = rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s())
    assert (found.deviations, found.contracted, found.deviated_at) == ((), True, 5)


@pytest.mark.clause("STM-8")
def test_a_person_restores_what_was_seen_until_then_and_nothing_later(rig):
    holder = slow(rig)
    probe(rig, holder)
    at = rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s()).deviated_at
    rig.registry.word = ConductWord(0, {}, {"robotic": told(restored_at=at - 1)})
    assert rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s()).contracted
    rig.registry.word = ConductWord(0, {}, {"robotic": told(restored_at=at)})
    assert not rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s()).contracted
    rig.clock.advance(2_000)
    probe(rig, holder)
    assert rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s()).contracted, "and it goes on watching"


def test_a_record_that_failed_is_not_heard(rig):
    rig.build(FailingJournal(rig.journal))
    answer = run(rig, beyond(rig, slow(rig)))
    assert str(answer.decision.reason) == "RECORD_FAILED"
    assert rig.gate.conduct.behaviour("robotic", at=rig.clock.wall_s()).samples == 0


def test_after_a_restart_its_own_journal_is_recalled(rig):
    holder = slow(rig)
    probe(rig, holder)
    run(rig, rig.call(holder, "read_state"))
    chain, at = chain_of(rig, holder), rig.clock.wall_s()
    before = rig.gate.conduct.trust(chain, at=at), rig.gate.conduct.behaviour("robotic", at=at)
    rig.restart()
    assert not rig.gate.conduct.behaviour("robotic", at=at).contracted
    rig.gate.conduct.recall(rig.journal.records())
    assert (rig.gate.conduct.trust(chain, at=at), rig.gate.conduct.behaviour("robotic", at=at)) == before


# --- how near to a bound ---------------------------------------------------------------------------------------------


def near(rig, values, bounds, *, impact=None, ceiling=Tier.HIGH_CONSEQUENCE, grant="move_joint"):
    limits = tuple(Limit(MOVE_JOINT.parameters[i], bound) for i, bound in enumerate(bounds))
    scope = full_scope(rig.clock.wall_s(), ceiling=ceiling)
    chain = chain_of(rig, rig.agent())
    leaf = replace(chain.leaf, scope=replace(scope, grants=(Grant("ur3e", grant, limits),)))
    request = replace(
        rig.call(rig.agent()).request,
        values=tuple(Quantity(f"q{i}", Unit.MICRORADIAN, value) for i, value in enumerate(values)),
    )
    evidence = Evidence(at=0.0, at_ms=0, chain=replace(chain, hops=(leaf,)), impact=impact or NOT_COLLECTED)
    return near_permille(request, evidence)


@pytest.mark.parametrize(
    ("values", "bounds", "expected"),
    [
        ((0,), (Range(-100, 100),), 0),
        ((90,), (Range(-100, 100),), 900),
        ((-90,), (Range(-100, 200),), 900),
        ((90,), (Range(-100, 200),), 450),
        ((0,), (Range(0, 100),), 0),
        ((100,), (Range(0, 100),), 1_000),
        ((150,), (Range(0, 100),), 1_000),
        ((30,), (Range(20, 100),), 300),
        ((-30,), (Range(-100, -20),), 300),
        ((-5,), (Range(0, 100),), 0),
        ((-30,), (Range(20, 100),), 0),
        ((30,), (Range(-100, -20),), 0),
        ((10, 80), (Range(0, 100), Range(0, 100)), 800),
        ((10, 5), (Range(0, 100), OneOf(frozenset({5}))), 100),
        ((5,), (OneOf(frozenset({5})),), None),
        ((), (), None),
    ],
)
def test_the_nearest_parameter_counts(rig, values, bounds, expected):
    assert near(rig, values, bounds) == expected


@pytest.mark.parametrize(
    ("index_milli", "ceiling", "expected"),
    [(0, 3, 100), (900, 3, 300), (2_900, 3, 966), (3_500, 3, 1_000), (1_900, 2, 950), (50, 0, 100)],
)
def test_physics_counts_against_the_ceiling(rig, index_milli, ceiling, expected):
    assert (
        near(rig, (10,), (Range(0, 100),), impact=reading(index_milli=index_milli), ceiling=Tier(ceiling)) == expected
    )


def test_what_is_not_granted_is_near_nothing(rig):
    assert near(rig, (10,), (Range(0, 100),), grant="other") is None


def test_it_stands_in_the_record(rig):
    run(rig, rig.call(rig.agent()))
    (record,) = rig.records("decision")
    assert record["body"]["near_permille"] == 700, "acceleration: 1.4 of 2 rad/s2"

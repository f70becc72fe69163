"""The benchmark of decisions: the engines are given equivalent rules, and that is proved before anything is timed."""

import importlib.util
import json
from dataclasses import replace
from importlib import resources

import pytest
from evaluation.decisions.engine import Said
from evaluation.decisions.ours import OurDecisions, Recorded
from evaluation.decisions.rules import NoPlainFormError, OtherFact, Op
from evaluation.harness.absent import AbsentError
from evaluation.harness.bench import Row
from evaluation.harness.timing import QUICK, Plan, WrongAnswerError
from typer.testing import CliRunner

from evaluation import cli
from evaluation.decisions import bench, cases, facts, rules
from policies import NOT_COLLECTED, SHIPPED, Effect, Point, load, load_shipped

pytestmark = pytest.mark.long

ONCE = Plan(repeats=1, rounds=1, warm_up=0)
SETS = {name: load_shipped(name) for name in SHIPPED if name != "tools"}
"""The sets for a robot: the cases are its motion, and its stop, which no set for other tools has."""
PACKAGES = {name: name.partition(",")[0] for name in bench.OTHERS}


def needs(name):
    if importlib.util.find_spec(PACKAGES[name]) is None:
        pytest.skip(f"{PACKAGES[name]} is not installed")


@pytest.mark.parametrize("name", bench.OTHERS)
@pytest.mark.parametrize("shipped", SETS)
def test_every_engine_answers_as_we_do_whatever_is_broken(shipped, name):
    needs(name)
    policies = SETS[shipped]
    engine = bench.OTHERS[name](rules.compiled(policies, cases.POINTS))
    assert bench.agree([OurDecisions(policies), engine], policies) > 75


# --- nothing in the rules is beyond the cases: a clause that no case breaks could be wrong in every language -----------


def holds(atom, given):
    if atom.fact not in given:
        return True
    value = given[atom.fact]
    other = given[atom.against.name] if isinstance(atom.against, OtherFact) else atom.against
    match atom.op:
        case Op.EQUAL:
            return value == other
        case Op.UNEQUAL:
            return value != other
        case Op.LESS:
            return value < other
        case Op.AT_MOST:
            return value <= other
        case Op.AT_LEAST:
            return value >= other
        case Op.ONE_OF:
            return value in other
        case Op.WITHIN:
            return value <= set(other)
        case Op.HAS:
            return other in value
        case Op.EMPTY:
            return not value


def asked(policies):
    yield from (case.situation(policies) for case in cases.CASES)
    yield from (cases.PERMIT.situation(policies, changes) for changes in cases.BROKEN.values())
    yield from (cases.STOP.situation(policies, cases.BROKEN[what]) for what in cases.BROKEN_STOP)


@pytest.mark.parametrize("shipped", SETS)
def test_every_clause_of_every_rule_is_broken_by_some_case(shipped):
    policies = SETS[shipped]
    situations = [situation.facts for situation in asked(policies)]
    unbroken = [
        (rule.name, clause)
        for rule in rules.compiled(policies, cases.POINTS)
        for clause in rule.holds
        if not any(
            all(holds(atom, given) for atom in rule.guard) and not any(holds(atom, given) for atom in clause)
            for given in situations
        )
    ]
    assert unbroken == []


@pytest.mark.parametrize("shipped", SETS)
def test_every_guard_lets_something_through_and_keeps_something_out(shipped):
    policies = SETS[shipped]
    move, stop = cases.PERMIT.situation(policies).facts, cases.STOP.situation(policies).facts
    for rule in rules.compiled(policies, cases.POINTS):
        if rule.guard:
            assert {all(holds(atom, given) for atom in rule.guard) for given in (move, stop)} == {True, False}, rule


class Liar(OurDecisions):
    """Answers as we do, but for one thing."""

    def __init__(self, policies, lie):
        super().__init__(policies)
        self.lie = lie

    def read(self, answer):
        return self.lie(super().read(answer), answer)


@pytest.mark.parametrize(
    "lie",
    [
        lambda said, answer: replace(said, effect=Effect.PERMIT) if said.effect is Effect.DEFER else said,
        lambda said, answer: replace(said, effect=Effect.DENY) if said.effect is Effect.DEFER else said,
        lambda said, answer: Said(Effect.PERMIT, ()) if "TEA-3" in (said.blamed or ()) else said,
        lambda said, answer: replace(said, blamed=("AID-1",)) if "TEA-2" in (said.blamed or ()) else said,
        lambda said, answer: Said(Effect.DENY, None),
    ],
)
def test_an_engine_that_answers_otherwise_is_not_measured(lie):
    policies = SETS[bench.SHIPPED]
    assert bench.agree([OurDecisions(policies), Liar(policies, lambda said, _: said)], policies)
    with pytest.raises(WrongAnswerError):
        bench.agree([OurDecisions(policies), Liar(policies, lie)], policies)


# --- what is given ---------------------------------------------------------------------------------------------------


def test_the_cases_have_the_effects_that_they_are_named_for():
    policies = SETS[bench.SHIPPED]
    ours = OurDecisions(policies)
    assert [ours.read(ours.ask(ours.ready(c.situation(policies)))).effect for c in cases.CASES] == [
        Effect.PERMIT, Effect.DENY, Effect.DEFER, Effect.PERMIT
    ]  # fmt: skip


def test_no_two_situations_are_the_same():
    policies = SETS[bench.SHIPPED]
    one, other = (cases.PERMIT.situation(policies) for _ in range(2))
    assert one.request != other.request
    assert one.evidence != other.evidence
    assert one.facts != other.facts


def test_a_reading_that_no_policy_looks_at_is_given_to_nobody():
    policies = SETS[bench.SHIPPED]
    collected = cases.readings(policies)
    situation = cases.PERMIT.situation(policies)
    for reading, names in facts.OF_READING.items():
        assert (getattr(situation.evidence, reading) is not NOT_COLLECTED) == (reading in collected)
        assert (names[0] in situation.facts) == (reading in collected)


def test_a_stop_is_decided_on_authority_alone():
    situation = cases.STOP.situation(SETS[bench.SHIPPED])
    assert situation.evidence.impact is NOT_COLLECTED
    assert "impact_tier" not in situation.facts


def shipped_with(before, after):
    text = resources.files("policies").joinpath("sets", f"{bench.SHIPPED}.toml").read_text("utf-8")
    assert before in text
    return load(text.replace(before, after, 1))


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('predicate = "TEA-3"', 'predicate = { any = ["TEA-3", "TEA-1"] }'),
        ('predicate = "TEA-3"', 'predicate = { not = { not = "TEA-3" } }'),
        ('subject = { agents = "any"', 'subject = { agents = ["mover"]'),
    ],
)
def test_what_has_no_plain_form_is_not_measured(before, after):
    policies = shipped_with(before, after)
    with pytest.raises(NoPlainFormError):
        rules.compiled(policies, frozenset(Point))


def test_a_number_of_the_set_is_a_number_of_the_rules():
    for age in (3_600, 1_800):
        policies = shipped_with("attestation_age_s = 3_600", f"attestation_age_s = {age}")
        (rule,) = (r for r in rules.compiled(policies, cases.POINTS) if r.name == "deny authority AID-1")
        assert age in {atom.against for clause in rule.holds for atom in clause}


# --- what is told ----------------------------------------------------------------------------------------------------


def absent(_):
    raise AbsentError("not installed: x")


@pytest.fixture(scope="module")
def result():
    def made(given):
        return OurDecisions(SETS[bench.SHIPPED])

    return bench.BENCH.run(ONCE, seed=1, told=lambda _: None, others={"another": made, "absent": absent})


def test_an_engine_that_is_not_installed_is_a_row_that_says_so(result):
    (row,) = (row for row in result.rows if row.of.case is None)
    assert (row.of.peer, row.why) == ("absent", "not installed: x")
    json.dumps(result.to_json())


def test_without_any_other_engine_ours_is_measured_alone():
    alone = bench.BENCH.run(ONCE, seed=1, told=lambda _: None, others={"absent": absent}).to_json()
    assert alone["ratios"] == dict.fromkeys(bench.RATIOS)
    assert {row["peer"] for row in alone["rows"] if row["case"]} == {OurDecisions.name, Recorded.name}


def test_a_ratio_is_of_the_calls_in_which_the_two_took_turns_in_the_worst_case():
    def row(peer, case, beside, us):
        return Row(bench.DecisionKey(peer, case, beside), p50_us=us, min_us=us / 2, p99_us=us, n=1)

    rows = (
        row("ztpm", "move", "cedarpy", 10.0),
        row("cedarpy", "move", "cedarpy", 100.0),
        row("ztpm", "stop", "cedarpy", 30.0),
        row("cedarpy", "stop", "cedarpy", 60.0),
        row("ztpm", "move", "casbin", 999.0),
        row("casbin", "move", "casbin", 1_000.0),
        Row(bench.DecisionKey("regopy"), why="not installed"),
    )
    assert bench.by_case(rows, "p50_us")["vs_cedarpy"] == {"move": 0.1, "stop": 0.5}
    assert bench.ratios(rows, {}, "p50_us") == {
        "vs_cedarpy": 0.5,
        "vs_cedarpy_two_rules": None,
        "vs_casbin": 0.999,
        "vs_regopy": None,
        "recorded_vs_cedarpy": None,
    }


def test_the_recorded_form_has_the_digest_of_its_evidence():
    policies = SETS[bench.SHIPPED]
    recorded = Recorded(policies)
    decision = recorded.ask(recorded.ready(cases.PERMIT.situation(policies)))
    assert len(decision.evidence_digest) == 64


@pytest.mark.campaign
def test_the_command_prints_one_object_with_every_measured_row():
    for name in bench.OTHERS:
        needs(name)
    told = CliRunner().invoke(cli.app, ["bench", "decide", "--quick", "--json"])
    assert told.exit_code == 0, told.output
    found = json.loads(told.stdout)
    assert {"vs_cedarpy", "vs_casbin", "vs_regopy"} <= found["ratios"].keys()
    assert all(value is not None for value in found["ratios"].values())
    measured = {(row["peer"], row["case"]) for row in found["rows"]}
    names = {OurDecisions.name, Recorded.name, *bench.OTHERS}
    assert measured == {(peer, case.name) for peer in names for case in cases.CASES}
    for row in found["rows"]:
        assert 0 < row["min_us"] <= row["p99_us"]
        assert row["n"] == QUICK.repeats * QUICK.rounds
        assert row["checks"]

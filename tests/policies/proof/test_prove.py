"""`policies.proof`: the shipped sets are proven, ten broken ones are caught, and the formulas are what `decide` does."""

import dataclasses
import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from capabilities.values.scope import Tier
from pep.base.declaration import row
from pep.base.fact_declaration import Fact
from policies.decision.combine import AllOf, Check
from policies.decision.policy import Concern, requirement
from policies.evidence.fact_reading import FactReading
from policies.evidence.tiers import runtime_tier
from policies.primitives.base import Case, Defers, Fails, Holds
from policies.proof.case_facts import observe, what_it_says
from policies.proof.facts import names_of
from policies.proof.laws import laws
from policies.proof.logic import PLAIN
from policies.proof.outcome import Added, Outcome, outcome
from policies.proof.verdicts import HOLDS, MAY_DEFER, is_known
from tests.model import triples
from typer.testing import CliRunner
from ztpm.cli import app as command_line

from policies import (
    ROWS,
    SHIPPED,
    ApprovalReading,
    DeclaredImpact,
    Effect,
    ImpactReading,
    Object,
    Parameters,
    Point,
    Policy,
    PolicySet,
    Subject,
    ToolReading,
    decide,
    load,
    load_shipped,
    proof,
)
from policies.decision import approval, combine, pdp
from policies.evidence import case_json
from policies.primitives import identity, propagation
from policies.proof import prover, search

pytestmark = pytest.mark.long

ROUNDS = int(os.environ.get("ZTPM_TWIN_ROUNDS", "1000"))
"""Triples for each of ten seeds; a campaign sets more."""
BROKEN = Path(__file__).parents[2] / "vectors" / "policies" / "broken"
PLANTED = {
    "no-human-root": {"P1"},
    "human-root-or-trust": {"P1"},
    "old-sponsors": {"P1"},
    "move-without-physics": {"P2", "P3", "P6"},
    "trust-alone": {"P1", "P2", "P3", "P6"},
    "one-agent-is-gated": {"P2", "P3", "P6", "P7"},
    "people-for-the-gate": {"P3", "P6"},
    "only-what-is-named": {"P2", "P3", "P6", "P7"},
    "gate-at-the-tool-only": {"P2", "P3", "P6", "P7"},
    "proof-by-approval": {"P6"},
}
"""Claims that each broken set breaks; all others are proven for it."""
CLAIMS = {claim.id: claim for claim in proof.CLAIMS}
needs_z3 = pytest.mark.skipif(prover.importlib.util.find_spec("z3") is None, reason="z3 is not installed")


def proven(policies, **options):
    return {result.claim.id: result for result in proof.prove(policies, clock=time.perf_counter, **options)}


def broken(name):
    return load((BROKEN / f"{name}.toml").read_text("utf-8"))


# --- the formulas are what the code does -----------------------------------------------------------------------------


def modelled(request, evidence, policies, added=None):
    """Effect, whether people brought it about, and the tier, as the formulas say with plain values."""
    names = names_of(policies, proof.HARMLESS)
    facts = observe(request, evidence, policies, names)
    assert all(laws(facts, names, PLAIN))
    said = outcome(policies, facts, names, PLAIN, added)
    (effect,) = [
        effect
        for effect, is_it in zip(("PERMIT", "DEFER", "DENY"), (said.permit, said.defer, said.deny), strict=True)
        if is_it
    ]
    return effect, said.by_people, said.at.tier if said.at.tier_known and facts.well_formed else None


def decided(request, evidence, policies):
    decision = decide(request, evidence, policies)
    return decision.effect, decision.approval is not None, decision.tier


def differ(seed, rounds):
    """True where the formulas and `decide` differ on any of so many random triples."""
    pick = random.Random(seed).choice
    cases = (triples.triple(pick) for _ in range(rounds))
    return any(modelled(*case) != decided(*case) for case in cases)


@pytest.mark.parametrize("seed", range(10))
def test_the_formulas_answer_as_decide_does(seed):
    pick = random.Random(seed).choice
    for number in range(ROUNDS):
        case = triples.triple(pick)
        assert modelled(*case) == decided(*case), f"seed {seed}, triple {number}"


@pytest.mark.parametrize("name", [*SHIPPED, *PLANTED])
def test_the_formulas_answer_as_decide_does_for_whole_sets(name):
    """Random sets are small; these are as long as real ones, and their names matter."""
    pick = random.Random(7).choice
    policies = load_shipped(name) if name in SHIPPED else broken(name)
    for number in range(ROUNDS // 6):
        request, evidence = triples.request(pick), triples.evidence(pick)
        evidence = triples.approved(pick, evidence, policies, decide(request, evidence, policies).tier)
        assert modelled(request, evidence, policies) == decided(request, evidence, policies), f"triple {number}"


def test_the_random_triples_reach_what_is_modelled():
    """A comparison that only ever sees denials would show little."""
    pick = random.Random(1).choice
    seen = {"PERMIT": 0, "DEFER": 0, "DENY": 0}
    by_people = 0
    for _ in range(1500):
        effect, people, _ = modelled(*triples.triple(pick))
        seen[effect] += 1
        by_people += people
    assert min(seen.values()) > 30, seen
    assert by_people > 10


def test_one_more_denial_is_modelled_as_what_it_does():
    """[P4] Any DENY policy is concerned or not, and denies, defers or is silent: nothing else of it matters."""
    pick = random.Random(3).choice
    for number in range(ROUNDS):
        request, evidence, policies = triples.triple(pick)
        policy = triples.policy(pick, "added")
        if policy.effect is not Effect.DENY:
            continue
        both = PolicySet(policies.name, policies.version, (*policies.policies, policy), policies.parameters)
        if evidence.approval not in (None, triples.NOT_COLLECTED):
            # an approval is bound to the set that decides, so each of the two has its own
            evidence = dataclasses.replace(
                evidence, approval=dataclasses.replace(evidence.approval, policy_digest=both.digest)
            )
        names = names_of(both, proof.HARMLESS)
        facts = observe(request, evidence, both, names)
        physical = requirement(request, both).physical
        case = Case(request, evidence, physical, runtime_tier(evidence, physical=physical))
        speaks = policy.subject.concern(evidence) is not Concern.NO
        verdict = combine.evaluate(policy.predicate, case) if speaks else Fails()
        added = Added(policy.concerns(request) is Concern.YES, isinstance(verdict, Holds), isinstance(verdict, Defers))
        said = outcome(policies, facts, names, PLAIN, added)
        decision = decide(request, evidence, both)
        assert (said.permit, said.deny) == (decision.effect == "PERMIT", decision.effect == "DENY"), number


def test_unknown_primitives_do_not_soften_with_the_tier():
    """[P5] What is taken for granted of primitives without a formula, tried on random cases."""
    pick = random.Random(5).choice
    unknown = [row for row in ROWS.values() if row.decides not in (HOLDS | MAY_DEFER)]
    primitives = [row.make(**{p.name: p.default for p in row.parameters}) for row in unknown]
    assert not any(is_known(primitive) for primitive in primitives)
    for _ in range(600):
        request, lower = triples.request(pick), triples.evidence(pick)
        if not isinstance(lower.impact, ImpactReading) or not isinstance(lower.tool, ToolReading):
            continue
        tiers = sorted(pick(list(Tier)) for _ in range(2))
        cases = []
        for tier in tiers:
            evidence = dataclasses.replace(lower, impact=dataclasses.replace(lower.impact, tier=tier))
            cases.append(Case(request, evidence, True, runtime_tier(evidence, physical=True)))
        for primitive in primitives:
            before, after = (what_it_says(primitive, case) for case in cases)
            assert after.raises or not before.raises, primitive
            assert not before.fails or after.fails or after.raises, primitive
            assert not after.holds or before.holds, primitive


def permits_instead_of_asking(policy, verdict, case):
    return (
        combine.PolicyAnswer(Effect.PERMIT, grants=True)
        if isinstance(verdict, Defers)
        else ORIGINAL(policy, verdict, case)
    )


ORIGINAL = pdp._permit
SABOTAGE = {
    "a permit is enough": (pdp, "deny_overrides", lambda answers: (Effect.PERMIT, ()) if any(a.effect is Effect.PERMIT for a in answers) else combine.deny_overrides(answers)),
    "a deferral is forgotten": (pdp, "_permit", permits_instead_of_asking),
    "nobody need grant": (pdp, "deny_overrides", lambda answers: combine.deny_overrides([*answers, combine.PolicyAnswer(None, grants=True)])),
    "any approval counts": (approval, "_differences", lambda *case: iter(())),
    "no age is too old": (identity, "age_within", lambda *case, **bounds: 0.0),
    "any trust is enough": (propagation.DynamicTrust, "_score", lambda primitive, score, case: Holds()),
}  # fmt: skip


@pytest.mark.parametrize("name", SABOTAGE)
def test_code_that_is_sabotaged_no_longer_answers_as_the_formulas(monkeypatch, name):
    monkeypatch.setattr(*SABOTAGE[name])
    assert any(differ(seed, ROUNDS) for seed in range(10))  # none without, as a test above shows


# --- shipped and broken sets -----------------------------------------------------------------------------------------


@needs_z3
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_set_is_proven(name):
    results = proven(load_shipped(name))
    assert {id: result.standing for id, result in results.items()} == dict.fromkeys(CLAIMS, proof.Standing.PROVEN)
    assert sum(result.seconds for result in results.values()) < 60


@needs_z3
def test_the_default_set_permits_what_is_claimed_about():
    """A claim about what never happens is no claim."""
    assert not any(result.about_nothing for result in proven(load_shipped("paper-default")).values())


def test_there_are_ten_broken_sets():
    assert {path.stem for path in BROKEN.glob("*.toml")} == set(PLANTED)
    assert len(PLANTED) == 10


@needs_z3
@pytest.mark.parametrize("name", PLANTED)
def test_a_broken_set_is_caught(name):
    policies = broken(name)
    results = proven(policies)
    assert {id for id, result in results.items() if result.standing is proof.Standing.BROKEN} == PLANTED[name]
    assert {
        id for id, result in results.items() if result.standing is proof.Standing.PROVEN
    } == CLAIMS.keys() - PLANTED[name]
    for id in PLANTED[name]:
        (shown,) = results[id].counterexample
        # once more from what is written, without anything of the prover
        (written,) = json.loads(json.dumps(proof.result_to_plain(results[id])))["counterexample"]
        again = case_json.read(written["case"])
        decision = decide(again.request, again.evidence, policies)
        assert decision == shown.told.decision
        assert decision.effect == "PERMIT"
        assert CLAIMS[id].shown(
            [dataclasses.replace(shown.told, request=again.request, evidence=again.evidence)], proof.HARMLESS
        )


@needs_z3
def test_nothing_is_harmless_that_is_not_called_so():
    """Anyone with a live token may stop. Were a stop an act, no human root would stand behind it."""
    results = proven(load_shipped("paper-default"), harmless=frozenset({"read_state"}))
    assert results["P1"].standing is proof.Standing.BROKEN
    assert results["P1"].counterexample[0].told.request.operation == "stop"


@needs_z3
def test_an_empty_set_is_proven_of_nothing():
    results = proven(PolicySet("empty", 1, (), Parameters()))
    assert all(result.standing is proof.Standing.PROVEN for result in results.values())
    assert {id for id, result in results.items() if result.about_nothing} == {"P1", "P2", "P3", "P6", "P7"}


def one_policy(effect, predicate, **more):
    """A policy that the loader would refuse: nothing looks whether it is well formed."""
    policy = object.__new__(Policy)
    members = {
        "id": "p", "subject": Subject(), "object": Object(), "points": frozenset({Point.TOOL, Point.ACTUATION}),
        "obligations": frozenset({triples.RECORD}), "pit_bound": None, **more, "effect": effect, "predicate": predicate,
    }  # fmt: skip
    for name, value in members.items():
        object.__setattr__(policy, name, value)
    return policy


def primitive(id, **values):
    row = ROWS[id]
    return Check(row.make(**({p.name: p.default for p in row.parameters} | values)))


@needs_z3
def test_a_denial_that_fails_at_a_higher_tier_is_caught():
    """[P5] The loader refuses it (LOOSENS): it forbids while the sponsor is fresh, so the higher tier frees the act."""
    forbids = one_policy(Effect.DENY, primitive("AID-2"), id="forbids")
    permits = one_policy(Effect.PERMIT, primitive("AID-1"), id="permits")
    result = proven(PolicySet("loosens", 1, (forbids, permits), Parameters()))["P5"]
    assert result.standing is proof.Standing.BROKEN
    lower, higher = (shown.told.decision for shown in result.counterexample)
    assert (lower.effect, higher.effect) == ("DENY", "PERMIT")
    assert lower.tier < higher.tier


@needs_z3
def test_primitives_without_a_formula_may_say_anything():
    """A set with them is proven where any of their answers proves it, and caught where they really hold."""
    unknown = [row.id for row in ROWS.values() if row.decides not in (HOLDS | MAY_DEFER)]
    at_both = [id for id in unknown if {Point.TOOL, Point.ACTUATION} <= ROWS[id].points]
    if not at_both:
        pytest.skip("every primitive has a formula")
    default = load_shipped("paper-default")
    extra = one_policy(Effect.PERMIT, AllOf(tuple(primitive(id) for id in at_both)), id="extra")
    results = proven(PolicySet("more", 1, (*default.policies, extra), Parameters()))
    assert all(result.standing is proof.Standing.PROVEN for result in results.values())
    assert set(at_both) <= set(results["P5"].assumed)
    alone = proven(PolicySet("alone", 1, (one_policy(Effect.PERMIT, primitive("ABG-1")),), Parameters()))
    assert alone["P1"].standing is proof.Standing.BROKEN


# --- what the prover does when it is wrong ---------------------------------------------------------------------------


@needs_z3
def test_a_counterexample_that_decide_does_not_confirm_is_a_fault(monkeypatch):
    monkeypatch.setattr(
        prover,
        "decide",
        lambda request, evidence, policies: decide(request, evidence, PolicySet("none", 1, (), Parameters())),
    )
    results = proven(broken("no-human-root"))
    assert results["P1"].standing is proof.Standing.FAULT
    # nor is a proof believed when what should be permitted is not
    assert results["P3"].standing is proof.Standing.FAULT


@needs_z3
def test_code_that_lets_one_person_approve_tier_4_is_caught(monkeypatch):
    """[P2] The claim is two people, and does not follow the code."""
    monkeypatch.setattr(approval, "APPROVERS_OF_TIER", {})
    monkeypatch.setattr("policies.proof.outcome.APPROVERS_OF_TIER", {})
    result = proven(load_shipped("paper-default"))["P2"]
    assert result.standing is proof.Standing.BROKEN
    (shown,) = result.counterexample
    assert (shown.told.decision.effect, shown.told.decision.tier) == ("PERMIT", 4)
    assert len(shown.told.evidence.approval.approvers) == 1


@needs_z3
def test_formulas_that_weaken_with_a_denial_are_a_fault(monkeypatch):
    def sabotaged(policies, facts, names, logic, added=None):
        said = outcome(policies, facts, names, logic, added)
        return said if added is None else Outcome(True, False, False, False, said.at)

    monkeypatch.setattr(search, "outcome", sabotaged)
    assert proven(load_shipped("paper-default"))["P4"].standing is proof.Standing.FAULT


def test_without_z3_nothing_is_proven(monkeypatch):
    monkeypatch.setattr(prover.importlib.util, "find_spec", lambda name: None)
    results = proven(load_shipped("paper-default"))
    assert {result.standing for result in results.values()} == {proof.Standing.SKIPPED}


def test_policies_and_their_proofs_import_without_z3():
    code = (
        "import sys; sys.modules['z3'] = None; import policies, policies.proof; policies.load_shipped('paper-default')"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture
def app():
    from ztpm.cli.policy.commands import app

    return app


@needs_z3
def test_the_command_tells_a_proof(app):
    told = CliRunner().invoke(app, ["prove", "--json"])
    said = json.loads(told.stdout)
    assert told.exit_code == 0
    assert said["ok"] is True
    assert [(claim["id"], claim["standing"]) for claim in said["claims"]] == [(id, "proven") for id in CLAIMS]
    assert CliRunner().invoke(app, ["prove", "--set", "paper-default"]).exit_code == 0


@needs_z3
def test_the_command_tells_a_counterexample(app):
    file = str(BROKEN / "proof-by-approval.toml")
    told = CliRunner().invoke(app, ["prove", file])
    assert told.exit_code == 1
    assert "PERMIT" in told.stdout
    said = json.loads(CliRunner().invoke(app, ["prove", file, "--json"]).stdout)
    assert said["ok"] is False
    assert [claim["id"] for claim in said["claims"] if claim["counterexample"]] == ["P6"]


@pytest.mark.parametrize(
    ("arguments", "status", "code"),
    [
        (["nowhere.toml"], 2, "UNREADABLE"),
        (["--set", "nonsense"], 2, "UNKNOWN_SET"),
        ([str(Path(__file__))], 2, "NOT_TOML"),
        ([str(BROKEN / "no-human-root.toml"), "--set", "paper-default"], 2, "USAGE"),
    ],
)
def test_the_command_names_what_is_wrong_with_its_input(arguments, status, code):
    told = CliRunner().invoke(command_line, ["policy", "prove", *arguments, "--json"])
    assert (told.exit_code, json.loads(told.stdout)["code"]) == (status, code)


def test_the_command_refuses_an_option_that_it_does_not_have(app):
    assert CliRunner().invoke(app, ["prove", "--nonsense"]).exit_code == 2


# --- class and declared rows ------------------------------------------------------------------------------------------


@needs_z3
def test_class_and_rows_are_never_lowered():
    """`pit = max(class, rows, world)`, for every class, every row and every world at once."""
    import z3
    from policies.proof.symbols import SYMBOLIC, any_fact, any_facts
    from policies.proof.verdicts import situation

    facts = any_facts([])
    bounds = [z3.And(0 <= each, each <= 4) for each in (facts.base_tier, facts.impact_tier)]
    for physical in (True, False):
        at = situation(facts, physical, SYMBOLIC)
        solver = z3.Solver()
        solver.add(
            *bounds, at.tier_known, z3.Or(at.tier < facts.base_tier, z3.And(physical, at.tier < facts.impact_tier))
        )
        assert solver.check() == z3.unsat
    # one further row on top of any: inside its values it raises to its tier, outside it changes nothing
    before, to, inside = any_fact("base_tier", "before"), any_fact("base_tier", "row"), z3.Bool("inside")
    after = z3.If(z3.And(inside, to > before), to, before)
    solver = z3.Solver()
    solver.add(z3.Or(after < before, z3.And(inside, after < to), z3.And(z3.Not(inside), after != before)))
    assert solver.check() == z3.unsat


def given_by_fact(fresh, holds, tiers, *, choose, most):
    """Tier that the row of a fact gives: the highest that holds, or of all where it is not fresh.

    With z3's `choose` and `most` it is a formula, with Python's the twin of the code.
    """
    none, unseen = 0, 3
    holding = none
    for inside, to in zip(holds, tiers, strict=True):
        holding = most(holding, choose(inside, to, none))
    highest = unseen
    for to in tiers:
        highest = most(highest, to)
    return choose(fresh, holding, highest)


@needs_z3
@pytest.mark.clause("FCT-3")
def test_rows_of_facts_never_lower_and_unknown_is_never_the_milder():
    """For every class and values' tier, every two tiers of a row, every fact, known or not."""
    import z3

    def most(one, other):
        return z3.If(one > other, one, other)

    before, tiers = z3.Int("before"), (z3.Int("inner"), z3.Int("outer"))
    bounds = [z3.And(0 <= each, each <= 4) for each in (before, *tiers)]
    fresh, holds = z3.Bool("fresh"), (z3.Bool("inside inner"), z3.Bool("inside outer"))
    after = most(before, given_by_fact(fresh, holds, tiers, choose=z3.If, most=most))
    unknown = most(before, given_by_fact(z3.BoolVal(False), holds, tiers, choose=z3.If, most=most))
    lowered = after < before
    unanswered = z3.And(z3.Not(fresh), after < 3)
    ignored = z3.And(fresh, z3.Or(*(z3.And(inside, after < to) for inside, to in zip(holds, tiers, strict=True))))
    milder = unknown < after
    invented = z3.And(fresh, z3.Not(z3.Or(*holds)), after != before)
    for wrong in (lowered, unanswered, ignored, milder, invented):
        solver = z3.Solver()
        solver.add(*bounds, wrong)
        assert solver.check() == z3.unsat


@pytest.mark.clause("FCT-3")
def test_the_code_gives_the_tier_of_the_formula():
    pick = random.Random(3).choice
    for _ in range(300):
        edges, tiers = (
            sorted(random.Random(pick(range(99))).sample(range(9), 2)),
            sorted(pick([(1, 3), (2, 4), (3, 4)])),
        )
        declared = row(
            "o", "p", {}, base_tier=0, exact=False, when={"s/f": Fact(at_least=dict(zip(edges, tiers, strict=True)))}
        )
        value, state = pick(range(-1, 11)), pick(["fresh", "stale", "missing", "invalid"])
        reading = FactReading("s/f", state, "", None if state == "missing" else value, "count", 1)
        held = [value >= at for at in edges]
        wanted = given_by_fact(state == "fresh", held, tiers, choose=lambda c, a, b: a if c else b, most=max)
        tier, raised_by = declared.tier_of((), pick([(reading,), (reading,), ()]) if state == "missing" else (reading,))
        assert (tier, raised_by) == (wanted, ("s/f",) if wanted else ())
        # whatever a gate makes of it, evidence that says so itself is not milder
        evidence = dataclasses.replace(
            triples.evidence(pick),
            impact=DeclaredImpact(Tier(0), (), (reading,)),
            tool=ToolReading("p", "d", "d", Tier(0)),
        )
        assert runtime_tier(evidence, physical=False) == (0 if state == "fresh" else 3)


def test_the_formulas_know_declared_impacts():
    pick, policies = random.Random(77).choice, load_shipped("tools")
    seen = {effect: 0 for effect in Effect}
    for number in range(ROUNDS):
        request = dataclasses.replace(triples.request(pick), points=frozenset({Point.TOOL}))
        evidence = triples.evidence(pick)
        facts = tuple(
            FactReading("zone-a/people", state, "", 0, "count", 1) for state in pick([(), ("fresh",), ("stale",)])
        )
        declared = DeclaredImpact(Tier(pick(range(5))), pick([(), ("opening",), ("zone-a/people",)]), facts)
        evidence = dataclasses.replace(evidence, impact=declared)
        evidence = triples.approved(pick, evidence, policies, decide(request, evidence, policies).tier)
        if isinstance(evidence.approval, ApprovalReading) and pick([True, True, False]):
            shown = evidence.approval.contributors | {("fact", "zone-a/people"), ("fact-unseen", "zone-a/people")}
            evidence = dataclasses.replace(
                evidence, approval=dataclasses.replace(evidence.approval, contributors=shown)
            )
        answer = decided(request, evidence, policies)
        assert modelled(request, evidence, policies) == answer, f"triple {number}"
        seen[answer[0]] += 1
    assert min(seen.values()) > 3, seen

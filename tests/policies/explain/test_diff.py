"""In what two sets differ: as texts, and in what they decide of cases."""

import pytest
from policies.evidence.case_json import RecordedCase
from policies.explain.differences import (
    Change,
    ComparedCase,
    ComparedDecision,
    Direction,
    of_decisions,
    of_sets,
    unseen,
)
from tests.policies import world
from tests.policies.decision.test_load import GOOD, but

from policies import SHIPPED, Effect, decide, load, load_shipped

DENIED, PERMITTED = ComparedDecision(Effect.DENY, "NO_POLICY"), ComparedDecision(Effect.PERMIT, "PERMITTED")


def recorded(given=None):
    return RecordedCase(*world.asked(given))


@pytest.mark.parametrize("name", SHIPPED)
def test_a_set_differs_in_nothing_from_itself(name):
    one = load_shipped(name)
    assert of_sets(one, one).same
    found = of_decisions([ComparedCase("a", recorded())], one, one)
    assert (found.direction, found.cases, found.moved) == (Direction.SAME, 1, ())


def test_neither_spelling_nor_name_nor_order_is_a_difference():
    two = GOOD + GOOD[GOOD.index("[[policy]]") :].replace('"one"', '"two"')
    turned = GOOD.replace('"one"', '"two"') + GOOD[GOOD.index("[[policy]]") :]
    assert of_sets(load(two), load(turned.replace('"small"', '"another"'))).same


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ('agents = "any"', 'agents = ["robotic"]', "subject.agents"),
        ('sponsors = "any"', 'sponsors = ["alice"]', "subject.sponsors"),
        ('ids = "any"', 'ids = ["ur3e"]', "object.ids"),
        ('operations = "any"', 'operations = ["stop"]', "object.operations"),
        ('operations = "any"', 'operations = "any", without = ["stop"]', "object.without"),
        ('"TEA-1"]', '"TEA-2"]', "predicate"),
        ('"AID-1"', '{ primitive = "AID-1", skew_s = 1 }', "predicate"),
        ('["e4", "e5"]', '["e4"]', "ep"),
        ('["record"]', '["record", "watch"]', "obligation"),
    ],
)
def test_a_changed_policy_is_named_with_what_changed(old, new, part):
    (changed,) = of_sets(load(GOOD), load(but(old, new))).policies
    assert (changed.id, changed.change, [p.part for p in changed.parts]) == ("one", Change.CHANGED, [part])
    assert changed.parts[0].was != changed.parts[0].now


def test_effect_and_bound_are_parts_too():
    prohibition = but('"PERMIT"', '"DENY"').replace('{ all = ["AID-1", "TEA-1"] }', '"always"')
    gated = but('"TEA-1"]', '"TEA-4"]').replace('"none"', "2")
    assert [p.part for p in of_sets(load(GOOD), load(prohibition)).policies[0].parts] == ["predicate", "effect"]
    assert [p.part for p in of_sets(load(GOOD), load(gated)).policies[0].parts] == ["predicate", "pit_bound"]


def test_policies_come_and_go_by_id():
    other = load(but('"one"', '"two"'))
    assert [(p.id, p.change) for p in of_sets(load(GOOD), other).policies] == [
        ("one", Change.REMOVED),
        ("two", Change.ADDED),
    ]


def test_a_parameter_is_compared_with_its_unit_and_what_cases_cannot_show_is_said():
    text = GOOD + "[parameters]\ntrust_theta_permille = 650\nlease_other_ms = 1000\ntrust_prior_permille = 700\n"
    change = of_sets(load(GOOD), load(text))
    assert ("trust_theta_permille", "700 permille", "650 permille") in [
        (p.part, p.was, p.now) for p in change.parameters
    ]
    # whatever collects evidence or acts afterwards
    assert set(unseen(change)) >= {"lease_other_ms"}
    assert "trust_theta_permille" not in unseen(change)
    assert unseen(of_sets(load(GOOD), load(GOOD + "[parameters]\nverdict_lifetime_ms = 1\n"))) == (
        "verdict_lifetime_ms",
    )


STRICT = GOOD.replace('"TEA-1"]', '"TEA-1", "CATP-3"]')


def test_stricter_milder_mixed_and_otherwise():
    low = ComparedCase("low", recorded({"evidence.trust.score_permille": 100, "evidence.tool.base_tier": 2}))
    strict, mild = load(STRICT), load(GOOD)
    assert of_decisions([low], mild, strict).direction is Direction.STRICTER
    assert of_decisions([low], strict, mild).direction is Direction.MILDER
    elsewhere = ComparedCase("elsewhere", recorded({"request.operation": "read_state"}))
    moved = load(STRICT.replace('operations = "any"', 'operations = ["move_joint"]'))
    milder_there = load(GOOD.replace('operations = "any"', 'operations = ["move_joint"]'))
    assert of_decisions([low, elsewhere], mild, moved).direction is Direction.STRICTER
    only_reading = load(GOOD.replace('operations = "any"', 'operations = ["read_state"]'))
    assert (
        of_decisions([ComparedCase("a", recorded()), elsewhere], only_reading, milder_there).direction
        is Direction.MIXED
    )
    revoked = ComparedCase("revoked", recorded({"evidence.chain": {"fault": "REVOKED"}}))
    assert of_decisions([revoked], mild, only_reading).direction is Direction.OTHERWISE


def test_each_class_has_its_count_and_first_examples():
    cases = [ComparedCase(f"n{i}", recorded(), PERMITTED) for i in range(5)] + [
        ComparedCase("kept", recorded(), DENIED)
    ]
    nobody = load(GOOD.replace('operations = "any"', 'operations = ["stop"]'))
    found = of_decisions(cases, None, nobody)
    assert found.cases == 6
    assert found.kept == ((DENIED, 1),)
    (moved,) = found.moved
    assert (moved.was, moved.now, moved.count, moved.examples) == (PERMITTED, DENIED, 5, ("n0", "n1", "n2"))


def test_an_approval_that_counted_counts_under_the_new_set_and_another_one_does_not():
    request, evidence, policies = world.approved(3)
    old = ComparedCase(
        "a", RecordedCase(request, evidence), ComparedDecision.of(decide(request, evidence, policies)), policies.digest
    )
    assert old.was.effect is Effect.PERMIT
    from importlib import resources

    text = resources.files("policies").joinpath("sets/paper-default.toml").read_text("utf-8")
    renamed = load(text.replace('name = "paper-default"', 'name = "mine"'))
    assert renamed.digest != policies.digest
    assert of_decisions([old], None, renamed).direction is Direction.SAME
    void = ComparedCase("b", old.recorded, ComparedDecision(Effect.DEFER, "APPROVAL_NOT_USABLE"), "0" * 64)
    assert of_decisions([void], None, renamed).direction is Direction.SAME

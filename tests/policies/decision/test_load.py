"""Strict loading: one table of bad sets, each with its fault and its place; and what a good set says."""

import random
import re

import pytest
from policies.decision.load import TEXT_LIMIT
from policies.decision.policy_text import DEPTH_LIMIT
from policies.decision.table import MEMBER_LIMIT, NAME_LIMIT

from policies import SHIPPED, Effect, Parameters, PolicyError, PolicyFault, load, load_shipped

GOOD = """
name = "small"
version = 1

[[policy]]
id = "one"
subject = { agents = "any", sponsors = "any" }
object = { ids = "any", operations = "any" }
predicate = { all = ["AID-1", "TEA-1"] }
ep = ["e4", "e5"]
effect = "PERMIT"
obligation = ["record"]
pit_bound = "none"
"""


def but(old, new):
    assert GOOD.count(old) == 1, old
    return GOOD.replace(old, new)


def nested(depth):
    return but('{ all = ["AID-1", "TEA-1"] }', "{ all = [" * depth + '"AID-1"' + "] }" * depth)


F = PolicyFault
BAD = {
    "nothing at all": ("", F.MISSING_KEY, "name"),
    "not TOML": ("name = ", F.NOT_TOML, "text"),
    "a key twice": (but("version = 1", "version = 1\nversion = 2"), F.NOT_TOML, "text"),
    "a table twice": (GOOD + "[parameters]\n[parameters]\n", F.NOT_TOML, "text"),
    "JSON": ('{"name": "small"}', F.NOT_TOML, "text"),
    "a NUL": (but('"small"', '"sm\\u0000all"'), F.OUT_OF_RANGE, "name"),
    "a lone surrogate": (but('"small"', '"\\ud800"'), F.NOT_TOML, "text"),
    "an invisible character": (but('"small"', '"sm\u200ball"'), F.OUT_OF_RANGE, "name"),
    "a direction override": (but('"small"', '"sm\u202eall"'), F.OUT_OF_RANGE, "name"),
    "too much text": (GOOD + "#" * TEXT_LIMIT, F.TOO_LARGE, "text"),
    "arrays as deep as a stack": ("x = " + "[" * 100_000, F.NOT_TOML, "text"),
    "an unknown key at the top": (GOOD.replace("version = 1", 'version = 1\ndefault = "PERMIT"'), F.UNKNOWN_KEY, "default"),
    "an unknown key in a policy": (GOOD + 'note = "x"\n', F.UNKNOWN_KEY, "policy[0].note"),
    "an unknown key in a subject": (but('sponsors = "any"', 'sponsors = "any", roles = "any"'), F.UNKNOWN_KEY, "policy[0].subject.roles"),
    "an unknown key in an object": (but('operations = "any"', 'operations = "any", tier = 1'), F.UNKNOWN_KEY, "policy[0].object.tier"),
    "an unknown parameter": (GOOD + "[parameters]\ntheta = 1\n", F.UNKNOWN_KEY, "parameters.theta"),
    "a missing name": (but('name = "small"', ""), F.MISSING_KEY, "name"),
    "a missing version": (but("version = 1", ""), F.MISSING_KEY, "version"),
    "no policies": ('name = "x"\nversion = 1\n', F.MISSING_KEY, "policy"),
    "an empty list of policies": ('name = "x"\nversion = 1\npolicy = []\n', F.EMPTY, "policy"),
    "policies that are no tables": ('name = "x"\nversion = 1\npolicy = [1]\n', F.WRONG_TYPE, "policy[0]"),
    "a missing subject": (but('subject = { agents = "any", sponsors = "any" }', ""), F.MISSING_KEY, "policy[0].subject"),
    "a subject without sponsors": (but(', sponsors = "any"', ""), F.MISSING_KEY, "policy[0].subject.sponsors"),
    "a missing object": (but('object = { ids = "any", operations = "any" }', ""), F.MISSING_KEY, "policy[0].object"),
    "a missing predicate": (but('predicate = { all = ["AID-1", "TEA-1"] }', ""), F.MISSING_KEY, "policy[0].predicate"),
    "a missing point": (but('ep = ["e4", "e5"]', ""), F.MISSING_KEY, "policy[0].ep"),
    "a missing effect": (but('effect = "PERMIT"', ""), F.MISSING_KEY, "policy[0].effect"),
    "a missing obligation": (but('obligation = ["record"]', ""), F.MISSING_KEY, "policy[0].obligation"),
    "a missing PITBound": (but('pit_bound = "none"', ""), F.MISSING_KEY, "policy[0].pit_bound"),
    "a form of tomorrow": (but("version = 1", "version = 1\nformat = 2"), F.UNKNOWN_FORMAT, "format"),
    "a form that is a text": (but("version = 1", 'version = 1\nformat = "1"'), F.WRONG_TYPE, "format"),
    "a form that is a fraction": (but("version = 1", "version = 1\nformat = 1.0"), F.WRONG_TYPE, "format"),
    "a name that is a number": (but('"small"', "7"), F.WRONG_TYPE, "name"),
    "an empty name": (but('"small"', '""'), F.OUT_OF_RANGE, "name"),
    "a long name": (but('"small"', f'"{"x" * (NAME_LIMIT + 1)}"'), F.OUT_OF_RANGE, "name"),
    "a version that is a text": (but("version = 1", 'version = "1"'), F.WRONG_TYPE, "version"),
    "a version that is true": (but("version = 1", "version = true"), F.WRONG_TYPE, "version"),
    "a version that is a fraction": (but("version = 1", "version = 1.0"), F.WRONG_TYPE, "version"),
    "a version that is zero": (but("version = 1", "version = 0"), F.OUT_OF_RANGE, "version"),
    "a version that is huge": (but("version = 1", "version = 2147483648"), F.OUT_OF_RANGE, "version"),
    "a version that is not a number": (but("version = 1", "version = nan"), F.NOT_FINITE, "version"),
    "a parameter that is not a number": (GOOD + "[parameters]\ntrust_theta_permille = nan\n", F.NOT_FINITE, "parameters.trust_theta_permille"),
    "an infinite parameter": (GOOD + "[parameters]\nlease_motion_ms = inf\n", F.NOT_FINITE, "parameters.lease_motion_ms"),
    "minus infinity": (GOOD + "[parameters]\nlease_motion_ms = -inf\n", F.NOT_FINITE, "parameters.lease_motion_ms"),
    "a parameter that is a fraction": (GOOD + "[parameters]\ntrust_theta_permille = 0.7\n", F.WRONG_TYPE, "parameters.trust_theta_permille"),
    "a parameter that is true": (GOOD + "[parameters]\nskew_s = true\n", F.WRONG_TYPE, "parameters.skew_s"),
    "a parameter that is a text": (GOOD + '[parameters]\nskew_s = "5"\n', F.WRONG_TYPE, "parameters.skew_s"),
    "a parameter one over its range": (GOOD + "[parameters]\nlease_motion_ms = 2001\n", F.OUT_OF_RANGE, "parameters.lease_motion_ms"),
    "a parameter one under its range": (GOOD + "[parameters]\nlease_motion_ms = 0\n", F.OUT_OF_RANGE, "parameters.lease_motion_ms"),
    "a theta over a thousand": (GOOD + "[parameters]\ntrust_theta_permille = 1001\n", F.OUT_OF_RANGE, "parameters.trust_theta_permille"),
    "parameters that are a list": (but("version = 1", "version = 1\nparameters = []"), F.WRONG_TYPE, "parameters"),
    "an id twice": (GOOD + GOOD[GOOD.index("[[policy]]") :], F.DUPLICATE_ID, "policy"),
    "agents that are nobody": (but('agents = "any"', "agents = []"), F.EMPTY, "policy[0].subject.agents"),
    "agents that are one text": (but('agents = "any"', 'agents = "robotic"'), F.WRONG_TYPE, "policy[0].subject.agents"),
    "an agent that is a number": (but('agents = "any"', "agents = [1]"), F.WRONG_TYPE, "policy[0].subject.agents[0]"),
    "an agent twice": (but('agents = "any"', 'agents = ["a", "a"]'), F.DUPLICATE_VALUE, "policy[0].subject.agents[1]"),
    "too many agents": (but('agents = "any"', f"agents = {[str(i) for i in range(MEMBER_LIMIT + 1)]}"), F.TOO_LARGE, "policy[0].subject.agents"),
    "an agent in a letter of another script": (but('agents = "any"', 'agents = ["m\u043ever"]'), F.NAME_MALFORMED, "policy[0].subject.agents[0]"),
    "an agent in capitals": (but('agents = "any"', 'agents = ["mover", "Mover"]'), F.NAME_MALFORMED, "policy[0].subject.agents[1]"),
    "an agent with a space behind": (but('agents = "any"', 'agents = ["mover "]'), F.NAME_MALFORMED, "policy[0].subject.agents[0]"),
    "an agent by its role": (but('agents = "any"', 'agents = ["role:planner"]'), F.NAME_MALFORMED, "policy[0].subject.agents[0]"),
    "an agent that is longer than registered ones": (but('agents = "any"', f'agents = ["{"a" * 64}"]'), F.NAME_MALFORMED, "policy[0].subject.agents[0]"),
    "any agent in a list": (but('agents = "any"', 'agents = ["any"]'), F.NAME_MALFORMED, "policy[0].subject.agents[0]"),
    "a sponsor in capitals": (but('sponsors = "any"', 'sponsors = ["Alice"]'), F.NAME_MALFORMED, "policy[0].subject.sponsors[0]"),
    "an object in a letter of another script": (but('ids = "any"', 'ids = ["ur3\u0435"]'), F.NAME_MALFORMED, "policy[0].object.ids[0]"),
    "an object with a space before": (but('ids = "any"', 'ids = [" ur3e"]'), F.NAME_MALFORMED, "policy[0].object.ids[0]"),
    "an operation with a space in it": (but('operations = "any"', 'operations = ["move joint"]'), F.NAME_MALFORMED, "policy[0].object.operations[0]"),
    "an operation with its object": (but('operations = "any"', 'operations = ["ur3e/stop"]'), F.NAME_MALFORMED, "policy[0].object.operations[0]"),
    "an exception in a letter of another script": (but('operations = "any"', 'operations = "any", without = ["st\u043ep"]'), F.NAME_MALFORMED, "policy[0].object.without[0]"),
    "an id with a filler": (but('id = "one"', 'id = "one\u3164"'), F.OUT_OF_RANGE, "policy[0].id"),
    "an empty exception": (but('operations = "any"', 'operations = "any", without = []'), F.EMPTY, "policy[0].object.without"),
    "a point that does not exist": (but('["e4", "e5"]', '["e6"]'), F.UNKNOWN_VALUE, "policy[0].ep[0]"),
    "no point": (but('["e4", "e5"]', "[]"), F.EMPTY, "policy[0].ep"),
    "a point twice": (but('["e4", "e5"]', '["e4", "e4"]'), F.DUPLICATE_VALUE, "policy[0].ep[1]"),
    "an effect in small letters": (but('"PERMIT"', '"permit"'), F.UNKNOWN_VALUE, "policy[0].effect"),
    "an effect from another system": (but('"PERMIT"', '"ALLOW"'), F.UNKNOWN_VALUE, "policy[0].effect"),
    "an obligation that does not exist": (but('["record"]', '["forget"]'), F.UNKNOWN_VALUE, "policy[0].obligation[0]"),
    "an obligation that a decision alone makes": (but('["record"]', '["record", "consume approval"]'), F.UNKNOWN_VALUE, "policy[0].obligation"),
    "a PERMIT that is not recorded": (but('["record"]', '["watch"]'), F.NO_RECORD, "policy[0].obligation"),
    "a PITBound of five": (but('pit_bound = "none"', "pit_bound = 5"), F.OUT_OF_RANGE, "policy[0].pit_bound"),
    "a negative PITBound": (but('pit_bound = "none"', "pit_bound = -1"), F.OUT_OF_RANGE, "policy[0].pit_bound"),
    "a PITBound that is another word": (but('pit_bound = "none"', 'pit_bound = "any"'), F.WRONG_TYPE, "policy[0].pit_bound"),
    "a PITBound that is true": (but('pit_bound = "none"', "pit_bound = true"), F.WRONG_TYPE, "policy[0].pit_bound"),
    "a PITBound without the impact gate": (but('pit_bound = "none"', "pit_bound = 3"), F.BOUND_WITHOUT_GATE, "policy[0].pit_bound"),
    "the impact gate without a PITBound": (but('"TEA-1"]', '"TEA-4"]'), F.BOUND_WITHOUT_GATE, "policy[0].pit_bound"),
    "a way round the impact gate": (
        but('{ all = ["AID-1", "TEA-1"] }', '{ any = ["AID-1", "TEA-4"] }').replace('"none"', "3"), F.BOUND_WITHOUT_GATE, "policy[0].pit_bound",
    ),
    "a primitive that does not exist": (but('"TEA-1"', '"TEA-7"'), F.UNKNOWN_PRIMITIVE, "policy[0].predicate.all[1]"),
    "a primitive in small letters": (but('"TEA-1"', '"tea-1"'), F.UNKNOWN_PRIMITIVE, "policy[0].predicate.all[1]"),
    "a primitive where it has no evidence": (but('"TEA-1"', '"TEA-3"'), F.WRONG_POINT, "policy[0].ep"),
    "a primitive's parameter that it does not have": (but('"TEA-1"', '{ primitive = "TEA-1", skew_s = 1 }'), F.UNKNOWN_KEY, "policy[0].predicate.all[1].skew_s"),
    "a primitive's parameter out of range": (
        but('"TEA-1"', '{ primitive = "AID-3", lease_motion_ms = 2001 }'), F.OUT_OF_RANGE, "policy[0].predicate.all[1].lease_motion_ms",
    ),
    "a primitive's parameter that is not a number": (
        but('"TEA-1"', '{ primitive = "AID-3", lease_motion_ms = nan }'), F.NOT_FINITE, "policy[0].predicate.all[1].lease_motion_ms",
    ),
    "a higher tier that asks for less": (
        but('"TEA-1"', '{ primitive = "AID-2", sponsor_age_tier_3_s = 28801 }'), F.NOT_MONOTONE, "policy[0].predicate.all[1].primitive",
    ),
    "a predicate that is a number": (but('{ all = ["AID-1", "TEA-1"] }', "1"), F.WRONG_TYPE, "policy[0].predicate"),
    "a predicate that is a list": (but('{ all = ["AID-1", "TEA-1"] }', '["AID-1"]'), F.WRONG_TYPE, "policy[0].predicate"),
    "an empty predicate": (but('{ all = ["AID-1", "TEA-1"] }', "{}"), F.EMPTY, "policy[0].predicate"),
    "all of nothing": (but('{ all = ["AID-1", "TEA-1"] }', "{ all = [] }"), F.EMPTY, "policy[0].predicate.all"),
    "any of nothing": (but('{ all = ["AID-1", "TEA-1"] }', "{ any = [] }"), F.EMPTY, "policy[0].predicate.any"),
    "two connectives at once": (but('{ all = ["AID-1", "TEA-1"] }', '{ all = ["AID-1"], any = ["TEA-1"] }'), F.UNKNOWN_KEY, "policy[0].predicate"),
    "an unknown connective": (but('{ all = ["AID-1", "TEA-1"] }', '{ none = ["AID-1"] }'), F.UNKNOWN_KEY, "policy[0].predicate.none"),
    "a predicate that is too deep": (nested(DEPTH_LIMIT), F.TOO_DEEP, "policy[0].predicate" + ".all[0]" * DEPTH_LIMIT),
    "a PERMIT that asks for nothing": (but('{ all = ["AID-1", "TEA-1"] }', '"always"'), F.LOOSENS, "policy[0].predicate"),
    "an alternative that asks for nothing": (but('{ all = ["AID-1", "TEA-1"] }', '{ any = ["AID-1", "always"] }'), F.LOOSENS, "policy[0].predicate"),
    "a PERMIT when a check fails": (but('{ all = ["AID-1", "TEA-1"] }', '{ not = "TEA-1" }'), F.LOOSENS, "policy[0].predicate"),
    "a DENY that a failing check lifts": (but('"PERMIT"', '"DENY"'), F.LOOSENS, "policy[0].predicate"),
    "a DEFER that a failing check lifts": (but('"PERMIT"', '"DEFER"'), F.LOOSENS, "policy[0].predicate"),
    "a DENY over the impact gate": (
        but('"PERMIT"', '"DENY"').replace('{ all = ["AID-1", "TEA-1"] }', '{ not = "TEA-4" }'), F.BOUND_WITHOUT_GATE, "policy[0].pit_bound",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_set_is_refused_with_its_fault_and_place(name):
    text, fault, where = BAD[name]
    with pytest.raises(PolicyError) as error:
        load(text)
    assert (error.value.code, error.value.where) == (fault, where)


def test_every_fault_has_a_bad_set():
    told_elsewhere = {F.UNKNOWN_SET, F.UNKNOWN_BASE, F.BASE_CYCLE, F.UNKNOWN_ID, F.LOSES_DENIAL, F.LOOSENS_NOTHING}
    assert {fault for _, fault, _ in BAD.values()} == set(PolicyFault) - told_elsewhere


@pytest.mark.parametrize("thing", [None, b"x", 7, ["x"]])
def test_what_is_no_text_is_refused(thing):
    with pytest.raises(PolicyError) as error:
        load(thing)
    assert error.value.code is PolicyFault.WRONG_TYPE


@pytest.mark.parametrize("name", ["", "paper_default", "../sets/paper-default", "paper-default.toml"])
def test_a_set_that_is_not_shipped_is_unknown(name):
    with pytest.raises(PolicyError) as error:
        load_shipped(name)
    assert error.value.code is PolicyFault.UNKNOWN_SET


def test_mutilated_sets_are_refused_or_load_and_nothing_else():
    """Cut, swap and repeat lines of the shipped set: a PolicyError or a set, never another exception."""
    from importlib import resources

    lines = resources.files("policies").joinpath("sets/paper-default.toml").read_text("utf-8").splitlines()
    chance = random.Random(20)
    loaded = 0
    for _ in range(400):
        some = list(lines)
        for _ in range(chance.randint(1, 3)):
            i, j = chance.randrange(len(some)), chance.randrange(len(some))
            match chance.randrange(4):
                case 0:
                    del some[i]
                case 1:
                    some[i], some[j] = some[j], some[i]
                case 2:
                    some.insert(i, some[j])
                case 3:
                    cut = chance.randrange(len(some[i]) + 1)
                    some[i] = some[i][:cut]
        try:
            load("\n".join(some))
            loaded += 1
        except PolicyError:
            pass
    assert loaded < 400


def test_the_good_set_loads():
    loaded = load(GOOD)
    assert (loaded.name, loaded.version, loaded.parameters) == ("small", 1, Parameters())
    assert [p.effect for p in loaded.policies] == [Effect.PERMIT]


def test_predicates_as_deep_as_allowed_load():
    assert load(nested(DEPTH_LIMIT - 1))


def test_the_sets_parameters_reach_the_primitives_and_a_policy_may_state_another():
    text = (
        but('"TEA-1"]', '{ primitive = "CATP-3", trust_theta_permille = 900 }, "CATP-3"]')
        + "[parameters]\ntrust_theta_permille = 650\n"
    )
    _, stated, common = load(text).policies[0].predicate.parts
    assert stated.primitive.trust_theta_permille == 900
    assert common.primitive.trust_theta_permille == 650


def test_the_digest_is_of_the_meaning_and_not_of_the_text():
    assert load(GOOD).digest == load("# a comment\n" + GOOD.replace(" = ", "=")).digest
    assert re.fullmatch("[0-9a-f]{64}", load(GOOD).digest)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"small"', '"other"'),
        ("version = 1", "version = 2"),
        ('"one"', '"two"'),
        ('agents = "any"', 'agents = ["robotic"]'),
        ('operations = "any"', 'operations = ["move_joint"]'),
        ('"TEA-1"]', '"TEA-2"]'),
        ('["e4", "e5"]', '["e4"]'),
        ('["record"]', '["record", "watch"]'),
        ('pit_bound = "none"\n', 'pit_bound = "none"\n[parameters]\nskew_s = 4\n'),
    ],
)
def test_the_digest_changes_with_every_part(old, new):
    assert load(but(old, new)).digest != load(GOOD).digest


def test_the_digest_does_not_depend_on_the_order_of_policies():
    one, two = GOOD[GOOD.index("[[policy]]") :], GOOD[GOOD.index("[[policy]]") :].replace('"one"', '"two"')
    head = GOOD[: GOOD.index("[[policy]]")]
    assert load(head + one + two).digest == load(head + two + one).digest


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_sets_load_and_state_every_parameter_and_all_but_one_the_defaults(name):
    from importlib import resources

    from policies import PARAMETERS

    text = resources.files("policies").joinpath("sets", f"{name}.toml").read_text("utf-8")
    assert (load(text).parameters == Parameters()) is (name != "strict")
    assert all(re.search(rf"^{parameter} = ", text, re.MULTILINE) for parameter in PARAMETERS)

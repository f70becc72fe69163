"""Warnings: each of them, and the sets that have none of it."""

import pytest
from policies.evidence.model import Point
from policies.explain.advice import AdviceCode, Known, Registered, advise
from tests.policies.decision.test_load import GOOD, but

from policies import load, load_shipped

A = AdviceCode
ACTING = frozenset({Point.TOOL, Point.ACTUATION})
KNOWN = (
    Known("ur3e", "move_joint", ACTING, moves=True),
    Known("ur3e", "read_state", ACTING),
    Known("press", "close_press", frozenset({Point.TOOL}), moves=True, sensors=frozenset({"zone-a"}), tool=True),
)
PARTIES = Registered(
    frozenset({"mover"}), frozenset({"alice"}), tools=frozenset({"read_state"}), sensors=frozenset({"zone-b"})
)
GATED = but('{ all = ["AID-1", "TEA-1"] }', '{ all = ["AID-1", "TEA-1", "TEA-4"] }').replace('"none"', "3")


def more(effect, predicate, **changes):
    """The good set with a second policy."""
    table = {
        "id": '"two"', "subject": '{ agents = "any", sponsors = "any" }', "object": '{ ids = "any", operations = "any" }',
        "predicate": predicate, "ep": '["e4", "e5"]', "effect": f'"{effect}"', "obligation": '["record"]', "pit_bound": '"none"',
    } | changes  # fmt: skip
    return GATED + "\n[[policy]]\n" + "\n".join(f"{key} = {value}" for key, value in table.items()) + "\n"


ONE = 'object = { ids = "any", operations = "any" }'
CASES = {
    "every operation is excepted again": (
        GATED.replace(ONE, 'object = { ids = "any", operations = ["stop"], without = ["stop"] }'), A.CONCERNS_NOTHING, "one",
    ),
    "a prohibition over everything": (more("DENY", '"always"'), A.SHADOWED, "one"),
    "the same twice": (
        more("PERMIT", '{ all = ["AID-1", "TEA-1", "TEA-4"] }', pit_bound="3"), A.REPEATED, "two",
    ),
    "motion without physics": (GOOD, A.MOTION_UNGATED, "ur3e/move_joint"),
    "an operation that nobody permits": (
        GATED.replace(ONE, 'object = { ids = "any", operations = ["move_joint"] }'), A.NEVER_PERMITTED, "ur3e/read_state",
    ),
    "an operation permitted elsewhere alone": (
        GOOD.replace('["e4", "e5"]', '["e2"]').replace('"TEA-1"', '"AID-3"'), A.NEVER_PERMITTED, "ur3e/move_joint",
    ),
    "a name with a slip": (GATED.replace(ONE, 'object = { ids = "any", operations = "any", without = ["stpo"] }'), A.OPERATION_UNKNOWN, "one"),
    "an object that the cell does not have": (GATED.replace(ONE, 'object = { ids = ["ur5e"], operations = "any" }'), A.OBJECT_UNKNOWN, "one"),
    "an operation at a point where nobody asks for it": (
        more("DENY", '"always"', object='{ ids = "any", operations = ["move_joint"] }', ep='["e2"]'), A.CONCERNS_NOTHING, "two",
    ),
    "an agent that nobody is": (GATED.replace('agents = "any"', 'agents = ["moved"]'), A.AGENT_UNKNOWN, "one"),
    "a sponsor that nobody is": (GATED.replace('sponsors = "any"', 'sponsors = ["alicf"]'), A.SPONSOR_UNKNOWN, "one"),
    "a tool that nobody registered": (GATED, A.TOOL_UNREGISTERED, "press/close_press"),
    "a sensor that nobody registered": (GATED, A.SENSOR_UNREGISTERED, "press/close_press"),
    "trust that nobody is given": (
        GATED.replace('"TEA-4"', '"TEA-4", "CATP-3"') + "[parameters]\ntrust_theta_permille = 801\n", A.TRUST_OUT_OF_REACH, "one",
    ),
    "a parameter for nobody": (GATED + "[parameters]\ntrust_theta_permille = 700\n", A.PARAMETER_UNUSED, "parameters.trust_theta_permille"),
    "a parameter that every policy states again": (
        GATED.replace('"AID-1"', '{ primitive = "AID-1", skew_s = 1 }') + "[parameters]\nskew_s = 4\n", A.PARAMETER_UNUSED, "parameters.skew_s",
    ),
    "a primitive that nobody asks": (GATED, A.PRIMITIVE_NOT_ASKED, "CATP-3"),
}  # fmt: skip


def advised(text):
    import tomllib

    stated = tomllib.loads(text).get("parameters", {})
    return {(a.code, a.where) for a in advise(load(text), stated=stated, known=KNOWN, registered=PARTIES)}


@pytest.mark.parametrize("name", CASES)
def test_what_is_probably_not_meant_is_told_with_its_place(name):
    text, code, where = CASES[name]
    assert (code, where) in advised(text)


def test_every_warning_has_a_case():
    assert {code for _, code, _ in CASES.values()} == set(AdviceCode)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (GATED, A.MOTION_UNGATED),
        (GATED, A.NEVER_PERMITTED),
        (GATED, A.CONCERNS_NOTHING),
        (GATED + "[parameters]\nskew_s = 4\n", A.PARAMETER_UNUSED),
        (
            GATED.replace('"TEA-4"', '"TEA-4", "CATP-3"') + "[parameters]\ntrust_theta_permille = 800\n",
            A.TRUST_OUT_OF_REACH,
        ),
        (GATED + "[parameters]\nlease_motion_ms = 1000\n", A.PARAMETER_UNUSED),  # the gate reads it
        (GATED + "[parameters]\nverdict_lifetime_ms = 40\n", A.PARAMETER_UNUSED),
        # a prohibition that leaves something over
        (more("DENY", '"always"', ep='["e5"]'), A.SHADOWED),
        (more("DENY", '"always"', subject='{ agents = ["robotic"], sponsors = "any" }'), A.SHADOWED),
        (more("DENY", '"always"', object='{ ids = "any", operations = "any", without = ["stop"] }'), A.SHADOWED),
        (more("DENY", '"always"', object='{ ids = "any", operations = ["move_joint"] }'), A.SHADOWED),
        (more("DENY", '{ not = "AID-1" }'), A.SHADOWED),
        (more("DEFER", '"always"'), A.SHADOWED),
    ],
)
def test_what_may_well_be_meant_is_not_told(text, code):
    assert code not in {found for found, _ in advised(text)}


def test_a_prohibition_of_named_operations_covers_a_policy_for_those():
    text = more("DENY", '"always"', object='{ ids = "any", operations = ["move_joint", "stop"] }').replace(
        ONE, 'object = { ids = ["ur3e"], operations = ["move_joint", "read_state"], without = ["read_state"] }', 1
    )
    assert (A.SHADOWED, "one") in advised(text)


def test_nothing_is_said_of_operations_where_nothing_is_known_of_the_cell():
    found = {a.code for a in advise(load(GOOD), stated=(), known=())}
    assert found == {A.PRIMITIVE_NOT_ASKED}


def test_the_shipped_set_covers_what_it_names():
    codes = {a.code for a in advise(load_shipped("paper-default"), stated=(), known=KNOWN)}
    assert not codes & {A.CONCERNS_NOTHING, A.SHADOWED, A.REPEATED, A.MOTION_UNGATED, A.NEVER_PERMITTED}

"""Arguments of declared tools: rounded once, decided, and handed on as decided; and rows that fit their tools."""

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcp_types import Tool
from pep.base.declaration import Within, row
from pep.base.errors import DeclarationError, PepFault
from pep.mcp.declared_tools import rows_of
from pep.mcp.mapping import Misfit, decided_arguments, rounded, to_request
from policies.evidence.model import Point
from policies.words.reason_table import Reason

ARGUMENTS = {
    "valve": Within(1, 12, integer=True),
    "percent": Within(-1_000, 1_000, "permille", scale=10),
    "bleed": "flag",
    "at": Within(-5_000_000, 5_000_000, "um", elements=2),
}
VALVE = row("valve-7", "open_valve", ARGUMENTS, base_tier=2, exact=False)
EXACT = row("valve-7", "open_valve", ARGUMENTS, base_tier=2, exact=True)
CALL = {"valve": 3, "percent": 45.0, "bleed": True, "at": [0.5, -0.25]}
SCHEMA = {
    "type": "object",
    "properties": {
        "valve": {"type": "integer"}, "percent": {"type": "number"}, "bleed": {"type": "boolean"},
        "at": {"type": "array", "items": {"type": "number"}},
    },
}  # fmt: skip


def asked(operation=VALVE, **changes):
    return to_request(operation, {**CALL, **changes}, request_id="r", audience="http://127.0.0.1:1/mcp", at=0.0)


def values(request):
    return [value.value for value in request.values]


def test_a_call_is_a_request_at_the_tool_alone():
    request = asked()
    assert values(request) == [3, 450, 1, 500_000, -250_000]
    assert request.points == {Point.TOOL}
    assert decided_arguments(VALVE, request) == CALL


# Ties go to the even one, as the number's decimal says it: 0.05 is a hair more in binary.
@pytest.mark.parametrize(
    ("given", "decided"),
    [(0.05, 0), (0.15, 2), (0.25, 2), (-0.05, 0), (-0.15, -2), (0.0500001, 1), (45.04, 450), (-0.0, 0), (1e-300, 0)],
)
def test_a_number_between_two_is_rounded_first(given, decided):
    request = asked(percent=given)
    assert values(request)[1] == decided
    told = rounded({**CALL, "percent": given}, decided_arguments(VALVE, request))
    assert told == ({} if given == decided / 10 else {"percent": decided / 10})
    sent = decided_arguments(VALVE, request)["percent"]
    assert math.copysign(1.0, sent) == (-1.0 if decided < 0 else 1.0)
    if given not in (0.0, -0.0):
        assert asked(EXACT, percent=given).reason is Reason.NOT_ON_GRID


@pytest.mark.parametrize(
    ("argument", "value", "reason", "named"),
    [
        ("valve", 2.5, Reason.NOT_ON_GRID, "valve"),
        ("valve", True, Reason.NOT_A_NUMBER, "valve"),
        ("valve", "3", Reason.NOT_A_NUMBER, "valve"),
        ("percent", math.nan, Reason.NOT_FINITE, "percent"),
        ("percent", math.inf, Reason.NOT_FINITE, "percent"),
        ("percent", 1e300, Reason.OUT_OF_RANGE, "percent"),
        ("percent", 10**400, Reason.OUT_OF_RANGE, "percent"),
        ("bleed", 1, Reason.PARAMETERS_WRONG, "bleed"),
        ("at", [0.0], Reason.PARAMETERS_WRONG, "at"),
        ("at", [0.0, "1"], Reason.NOT_A_NUMBER, "at[1]"),
        ("at", [math.nan, 0.0], Reason.NOT_FINITE, "at[0]"),
    ],
)
def test_what_is_no_number_is_refused_by_its_place(argument, value, reason, named):
    misfit = asked(**{argument: value})
    assert isinstance(misfit, Misfit)
    assert (misfit.reason, misfit.argument) == (reason, named)


def test_a_missing_or_further_argument_is_refused():
    missing = to_request(VALVE, {"valve": 3}, request_id="r", audience="a", at=0.0)
    assert (missing.reason, missing.argument) == (Reason.PARAMETERS_WRONG, "percent")
    assert asked(further=1).reason is Reason.PARAMETERS_WRONG


@settings(max_examples=60)
@given(st.floats(-100.0, 100.0), st.floats(-5.0, 5.0))
def test_what_the_tool_gets_is_what_was_decided(percent, at):
    request = asked(percent=percent, at=[at, 0.0])
    again = asked(**decided_arguments(VALVE, request))
    assert again.digest == request.digest
    nearest = Fraction(repr(percent)) * 10
    assert abs(values(request)[1] - nearest) <= Fraction(1, 2)


# --- rows and tools ---------------------------------------------------------------------------------------------------


def served(schema=SCHEMA, name="open_valve"):
    return Tool(name=name, input_schema=schema)


def without(name):
    return {**SCHEMA, "properties": {k: v for k, v in SCHEMA["properties"].items() if k != name}}


def typed(name, schema):
    return {**SCHEMA, "properties": {**SCHEMA["properties"], name: schema}}


def test_a_row_that_fits_is_the_tools():
    assert rows_of([served()], decorated={}, configured={"open_valve": VALVE}) == {"open_valve": VALVE}
    renamed = rows_of([served(name="v7")], decorated={"v7": VALVE}, configured={})
    assert renamed["v7"].name == "v7", "an operation is called as its tool"


@pytest.mark.parametrize(
    "schema",
    [
        without("bleed"),
        typed("query", {"type": "string"}),
        typed("valve", {"type": "number"}),
        typed("percent", {"type": "integer"}),
        typed("bleed", {"type": "integer"}),
        typed("at", {"type": "array", "items": {"type": "string"}}),
        typed("at", True),
        {},
    ],
)
def test_a_schema_that_differs_is_refused_at_start(schema):
    with pytest.raises(DeclarationError) as refused:
        rows_of([served(schema)], decorated={"open_valve": VALVE}, configured={})
    assert refused.value.code is PepFault.TOOL_SCHEMA_DIFFERS
    assert "open_valve" in refused.value.detail


@pytest.mark.parametrize(
    ("tools", "decorated", "configured", "code"),
    [
        (["open_valve", "open_valve"], {"open_valve": VALVE}, {}, PepFault.TOOL_TWICE),
        (["open_valve"], {"open_valve": VALVE}, {"open_valve": VALVE}, PepFault.TOOL_TWICE),
        (["open_valve"], {}, {}, PepFault.TOOL_UNDECLARED),
        ([], {}, {"open_valve": VALVE}, PepFault.TOOL_UNKNOWN),
    ],
)
def test_every_tool_has_one_row(tools, decorated, configured, code):
    with pytest.raises(DeclarationError) as refused:
        rows_of([served(name=name) for name in tools], decorated=decorated, configured=configured)
    assert refused.value.code is code

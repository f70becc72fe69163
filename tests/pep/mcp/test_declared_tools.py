"""Arguments of declared tools: rounded once, decided, and handed on as decided; and rows that fit their tools."""

import asyncio
import functools
import hashlib
import math
from fractions import Fraction
from typing import Annotated

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcp.server import MCPServer
from mcp_types import Tool
from capabilities.values.arguments import kind_given, plain
from pep.base.declaration import operation, row
from pep.base.errors import DeclarationError, PepFault
from pep.base.stated_values import Free, Length, Listed, Within, Word
from pep.mcp.declared_tools import decorated, definition_of, rows_of
from pep.mcp.mapping import Misfit, decided_arguments, rounded, to_request
from pep.mcp.tool_digest import definition_digest
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
    assert decided_arguments(VALVE, request, CALL) == CALL


# Ties go to the even one, as the number's decimal says it: 0.05 is a hair more in binary.
@pytest.mark.parametrize(
    ("given", "decided"),
    [(0.05, 0), (0.15, 2), (0.25, 2), (-0.05, 0), (-0.15, -2), (0.0500001, 1), (45.04, 450), (-0.0, 0), (1e-300, 0)],
)
def test_a_number_between_two_is_rounded_first(given, decided):
    request = asked(percent=given)
    assert values(request)[1] == decided
    told = rounded({**CALL, "percent": given}, decided_arguments(VALVE, request, CALL))
    assert told == ({} if given == decided / 10 else {"percent": decided / 10})
    sent = decided_arguments(VALVE, request, CALL)["percent"]
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
    again = asked(**decided_arguments(VALVE, request, CALL))
    assert again.digest == request.digest
    nearest = Fraction(repr(percent)) * 10
    assert abs(values(request)[1] - nearest) <= Fraction(1, 2)


# --- words, flags, free values and lists -----------------------------------------------------------------------------

ROWS = {
    "query": Word(starts_with=("pump",)),
    "path": Word("path", under=("/srv",)),
    "page": Word("url", under=("https://docs.example",)),
    "filter": Free(64),
    "tags": Listed(Word(), Length(0, 2)),
    "bars": Listed(Within(0, 6_000, "x-bar", scale=1_000), Length(1, 3)),
    "pins": Listed(Within(1, 9, integer=True), Length(0, 2)),
    "sides": Listed("flag", Length(0, 2)),
}
SEARCH = row("docs", "search", ROWS, base_tier=1, exact=False)
SOUGHT = {
    "query": "pump 7", "path": "/srv/a", "page": "https://docs.example/x", "filter": {"b": 1.0, "a": [True, None]},
    "tags": ["é", ""], "bars": [0.5, 2], "pins": [3], "sides": [True],
}  # fmt: skip


def sought(**changes):
    return to_request(SEARCH, {**SOUGHT, **changes}, request_id="r", audience="http://127.0.0.1:1/mcp", at=0.0)


def test_values_of_each_kind_are_a_request_and_the_tool_gets_what_was_decided():
    request = sought()
    assert [str(kind_given(value)) for value in request.values] == [
        "text", "path", "url", "free", "[text]", "[x-bar/1000]", "[count]", "[flag]",
    ]  # fmt: skip
    assert [plain(value) for value in request.values] == [
        "pump 7", "/srv/a", "https://docs.example/x",
        {"size_bytes": 23, "sha256": hashlib.sha256(b'{"a":[true,null],"b":1}').hexdigest()},
        ["é", ""], [500, 2_000], [3], [True],
    ]  # fmt: skip
    decided = decided_arguments(SEARCH, request, SOUGHT)
    assert decided == SOUGHT
    assert type(decided["filter"]["b"]) is int, "as the decided form says it"
    assert sought(**decided).digest == request.digest


LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text()


def larger(inner):
    return st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3)


JSON = st.recursive(LEAVES, larger)
WORDS = st.text(st.sampled_from("ab /é水\u0301\u200b"), max_size=4)
STATED = {"free": Free(10_000), "whole": Free(10_000, text=True), "text": Word(), "texts": Listed(Word(), Length())}
NOTE = row("docs", "note", STATED, base_tier=1, exact=False)


@settings(max_examples=30)
@given(JSON, JSON | st.text(), WORDS, st.lists(WORDS, max_size=3))
def test_any_value_is_refused_or_reaches_the_tool_as_it_was_decided(free, whole, text, texts):
    call = {"free": free, "whole": whole, "text": text, "texts": texts}
    request = to_request(NOTE, call, request_id="r", audience="a", at=0.0)
    if isinstance(request, Misfit):
        assert request.reason in {Reason.NOT_CANONICAL, Reason.PARAMETERS_WRONG}
        return
    decided = decided_arguments(NOTE, request, call)
    assert decided == call
    assert to_request(NOTE, decided, request_id="", audience="a", at=0.0).digest == request.digest


def test_a_text_of_several_lines_is_a_free_value_where_it_is_declared_so():
    write = row("docs", "write", {"content": Free(64, text=True)}, base_tier=1, exact=False)
    lines = "one\n\ttwo \u200b e\u0301"
    request = to_request(write, {"content": lines}, request_id="r", audience="a", at=0.0)
    assert decided_arguments(write, request, {"content": lines}) == {"content": lines}
    for wrong in (7, None, ["one"], {"text": "one"}):
        misfit = to_request(write, {"content": wrong}, request_id="r", audience="a", at=0.0)
        assert (misfit.reason, misfit.argument) == (Reason.PARAMETERS_WRONG, "content")
    long = to_request(write, {"content": "x" * 63}, request_id="r", audience="a", at=0.0)
    assert write.refuse(long).code == "LIMIT_EXCEEDED_BY_REQUEST"
    for kind, fits in (({"type": "string"}, True), ({"type": ["string", "null"]}, False), ({"type": "object"}, False)):
        tool = Tool(name="write", input_schema={"type": "object", "properties": {"content": kind}})
        try:
            assert rows_of([tool], decorated={"write": write}, configured={}) == {"write": write}
        except DeclarationError as refused:
            assert (refused.code, fits) == (PepFault.TOOL_SCHEMA_DIFFERS, False)
        else:
            assert fits


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("query", "pump 8"),
        ("filter", {"a": [True, None], "b": 2}),
        ("tags", ["", "é"]),
        ("sides", [False]),
        ("pins", []),
    ],
)
def test_another_value_of_any_kind_is_another_act(argument, value):
    assert sought(**{argument: value}).digest != sought().digest


@pytest.mark.parametrize(
    ("argument", "value", "reason", "named"),
    [
        ("query", 7, Reason.PARAMETERS_WRONG, "query"),
        ("query", "pu\u200bmp", Reason.NOT_CANONICAL, "query"),
        ("path", "/srv/../etc", Reason.NOT_CANONICAL, "path"),
        ("page", "https://DOCS.example/x", Reason.NOT_CANONICAL, "page"),
        ("filter", "[1]", Reason.PARAMETERS_WRONG, "filter"),
        ("filter", {"a": math.nan}, Reason.NOT_CANONICAL, "filter"),
        ("tags", "ab", Reason.PARAMETERS_WRONG, "tags"),
        ("tags", ["a", "e\u0301"], Reason.NOT_CANONICAL, "tags[1]"),
        ("tags", ["a"] * 100_000, Reason.OUT_OF_RANGE, "tags"),
        ("bars", [0.5, 0.0005], Reason.NOT_ON_GRID, "bars[1]"),
        ("bars", [0.5, "1"], Reason.NOT_A_NUMBER, "bars[1]"),
        ("pins", [1.5], Reason.NOT_ON_GRID, "pins[0]"),
        ("sides", [1], Reason.PARAMETERS_WRONG, "sides[0]"),
    ],
)
def test_what_is_no_value_of_its_kind_is_refused_by_its_place(argument, value, reason, named):
    misfit = sought(**{argument: value})
    assert isinstance(misfit, Misfit)
    assert (misfit.reason, misfit.argument) == (reason, named)


@pytest.mark.parametrize(
    ("argument", "value", "nearest"),
    [
        ("query", "pumq", "pump"), ("path", "/etc", "/srv"), ("page", "https://docs.example:8443/x", "https://docs.example"),
        ("filter", ["x" * 99], None), ("tags", ["a", "b", "c"], ("a", "b")), ("bars", [0.0, 9], (0, 6_000)),
        ("bars", [], None),
    ],
)  # fmt: skip
def test_a_value_outside_the_row_is_refused_with_the_nearest_one(argument, value, nearest):
    refused = SEARCH.refuse(sought(**{argument: value}))
    assert (refused.code, refused.parameter, refused.nearest) == ("LIMIT_EXCEEDED_BY_REQUEST", argument, nearest)


def test_a_member_of_a_list_raises_the_tier():
    stated = {"bars": Listed(Within(0, 9, above={5: 3}), Length())}
    raised = row("boiler", "load", stated, base_tier=1, exact=False)
    for bars, tier in (([], 1), ([5, 1], 1), ([1, 6], 3)):
        request = to_request(raised, {"bars": bars}, request_id="r", audience="a", at=0.0)
        assert raised.tier_of(request.values) == (tier, ("bars",) if tier == 3 else ())


# --- defaults ---------------------------------------------------------------------------------------------------------


def defaulting():
    server = MCPServer("plant", log_level="ERROR")

    @server.tool()
    @operation("docs", base_tier=0)
    def search(
        query: str,
        top: Annotated[int, Within(1, 9)] = 3,
        under: Annotated[str, Word("path")] = "/",
        tags: list[str] = [],
    ) -> str:  # noqa: B006 - a signature's default
        return f"{query} {top} {under} {tags}"

    return server


def test_an_argument_that_is_left_out_has_the_default_of_the_tools_own_signature():
    server = defaulting()
    (row_,) = rows_of(
        asyncio.run(server.list_tools()), decorated=asyncio.run(decorated(server)), configured={}
    ).values()
    assert [argument.default for argument in row_.arguments] == [None, "3", '"/"', "[]"]
    short, whole = {"query": "a"}, {"query": "a", "top": 3, "under": "/", "tags": []}
    left, given_ = (to_request(row_, each, request_id="r", audience="a", at=0.0) for each in (short, whole))
    assert left.digest == given_.digest, "it is decided on and recorded like a given one"
    assert decided_arguments(row_, left, short) == whole
    assert rounded(short, whole) == {}
    missing = to_request(row_, {"top": 1}, request_id="r", audience="a", at=0.0)
    assert (missing.reason, missing.argument) == (Reason.PARAMETERS_WRONG, "query")
    assert definition_of(row_, "").input_schema["required"] == ["query"]


@pytest.mark.parametrize("default", [0, 3.5, "3", None])
def test_a_default_that_is_no_value_of_its_row_is_refused_at_start(default):
    stated = {"type": "object", "properties": {"top": {"type": "integer", "default": default}}}
    top = row("docs", "search", {"top": Within(1, 9, integer=True)}, base_tier=0, exact=False)
    with pytest.raises(DeclarationError) as refused:
        rows_of([Tool(name="search", input_schema=stated)], decorated={}, configured={"search": top})
    assert (refused.value.code, "search.top" in refused.value.detail) == (PepFault.DECLARATION_MALFORMED, True)


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
        typed("percent", {"anyOf": [{"type": "integer"}, {"type": "string"}]}),
        {"type": "object", "properties": [], "required": "all"},
        {},
    ],
)
def test_a_schema_that_differs_is_refused_at_start(schema):
    with pytest.raises(DeclarationError) as refused:
        rows_of([served(schema)], decorated={"open_valve": VALVE}, configured={})
    assert refused.value.code is PepFault.TOOL_SCHEMA_DIFFERS
    assert "open_valve" in refused.value.detail


def test_a_mapping_may_leave_out_what_a_tool_does_not_require():
    """A call cannot give it then: what no row limits does not reach the server."""
    wider = typed("depth", {"type": "integer"}) | {"required": sorted(SCHEMA["properties"])}
    row_ = rows_of([served(wider)], decorated={}, configured={"open_valve": VALVE})["open_valve"]
    assert decided_arguments(row_, asked(row_), CALL) == CALL
    assert asked(row_, depth=1).reason is Reason.PARAMETERS_WRONG
    for stated in (
        {"decorated": {"open_valve": VALVE}, "configured": {}}, {"decorated": {}, "configured": {"open_valve": VALVE}},
    ):  # fmt: skip
        with pytest.raises(DeclarationError) as refused:
            rows_of([served({**wider, "required": ["depth"]})], **stated)
        assert (refused.value.code, "open_valve.depth" in refused.value.detail) == (PepFault.TOOL_SCHEMA_DIFFERS, True)


@pytest.mark.parametrize(
    ("name", "schema"),
    [
        ("percent", {"anyOf": [{"type": "number"}, {"type": "null"}], "default": None}),
        ("bleed", {"type": ["boolean", "string"]}),
        ("percent", True),
        ("at", {"type": "array", "items": {}}),
        ("valve", {"$ref": "#/$defs/Valve"}),
        ("at", {"anyOf": [{"type": "array", "items": {"$ref": "#/$defs/Metres"}}, {"type": "null"}]}),
    ],
)
def test_a_schema_of_more_values_than_the_row_fits(name, schema):
    kinds = {"Valve": {"enum": [1, 2, 12]}, "Metres": {"type": "number"}}
    fits = {**typed(name, schema), "$defs": kinds}
    row_ = rows_of([served(fits)], decorated={"open_valve": VALVE}, configured={})["open_valve"]
    assert row_ == VALVE, "a null in place of a value is no default"
    assert asked(row_, **{name: None}).argument == name


def test_a_text_is_of_a_schema_that_reads_nothing_else_in_it():
    """Servers that take more than texts read JSON in them.

    The text "null" would reach the tool as none at all."""
    nullable = {"type": "object", "properties": {"word": {"anyOf": [{"type": "string"}, {"type": "null"}]}}}
    listed = {"type": "object", "properties": {"word": {"type": "array", "items": nullable["properties"]["word"]}}}
    for word, schema, fits in (
        (Word(), nullable, False), (Word(one_of=("a", "null")), nullable, False), (Word(one_of=("a", "b")), nullable, True),
        (Word("path", under=("/srv",)), nullable, True), (Listed(Word(), Length()), listed, False),
        (Listed(Word(starts_with=("a",)), Length()), listed, True),
    ):  # fmt: skip
        said = row("docs", "say", {"word": word}, base_tier=0, exact=False)
        try:
            rows_of([Tool(name="say", input_schema=schema)], decorated={}, configured={"say": said})
        except DeclarationError as refused:
            assert (refused.code, fits) == (PepFault.TOOL_SCHEMA_DIFFERS, False)
        else:
            assert fits, word


@pytest.mark.parametrize(
    ("name", "schema"),
    [
        ("query", {"type": "integer"}), ("path", {}), ("tags", {"type": "string"}), ("sides", {"type": "array"}),
        ("tags", {"type": "array", "items": {"type": "integer"}}), ("bars", {"type": "array"}), ("tags", {"type": "array", "items": {}}),
    ],
)  # fmt: skip
def test_a_schema_of_another_kind_is_refused_at_start(name, schema):
    fits = definition_of(SEARCH, "Search.")
    assert rows_of([fits], decorated={"search": SEARCH}, configured={}) == {"search": SEARCH}
    differs = {**fits.input_schema, "properties": {**fits.input_schema["properties"], name: schema}}
    with pytest.raises(DeclarationError) as refused:
        rows_of([Tool(name="search", input_schema=differs)], decorated={"search": SEARCH}, configured={})
    assert (refused.value.code, f"search.{name}" in refused.value.detail) == (PepFault.TOOL_SCHEMA_DIFFERS, True)


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


def test_a_definition_that_runs_again_for_another_server_is_one_definition():
    made = [defaulting() for _ in range(2)]
    assert [list(asyncio.run(decorated(each))) for each in made] == [["search"], ["search"]]


MODULE = """
@{outer}
@server.tool()
@{inner}
def vent(hall: str) -> str:
    return hall
"""


@pytest.mark.parametrize("inner", ["wrapped", "operation('plant', base_tier=1)", "plain"])
@pytest.mark.parametrize("outer", ["wrapped", "plain"])
@pytest.mark.parametrize(("times", "code"), [(1, None), (2, PepFault.TOOL_TWICE)])
def test_a_module_that_defines_a_tool_twice_is_refused_with_any_decorators(times, code, outer, inner):
    server, text = MCPServer("plant", log_level="ERROR"), MODULE.format(outer=outer, inner=inner) * times

    def wrapped(function):
        return functools.wraps(function)(lambda *given, **named: function(*given, **named))

    names = {
        "__name__": f"plant of {text}",
        "server": server,
        "wrapped": wrapped,
        "plain": lambda each: each,
        "operation": operation,
    }
    exec(compile(text, "module", "exec"), names)  # noqa: S102 - a module
    if code is None:
        assert set(asyncio.run(decorated(server))) == ({"vent"} if "operation" in inner else set())
        return
    with pytest.raises(DeclarationError) as refused:
        asyncio.run(decorated(server))
    assert refused.value.code is code


def test_each_definition_has_a_digest_of_all_that_goes_on():
    def digest(meta=None, **bounds):
        schema = {"type": "object", "properties": {"n": {"type": "integer", **bounds}}}
        return definition_digest(Tool(name="act", input_schema=schema, _meta=meta))

    known = [
        digest(), digest(maximum=2**64 - 1), digest(maximum=2**64 - 2), digest(maximum=2**53), digest(maximum=3),
        digest(meta={"ui": {"resourceUri": "ui://a"}}), digest(meta={"ui": {"resourceUri": "ui://b"}}),
    ]  # fmt: skip
    assert len(set(known)) == len(known)
    assert digest(maximum=3.0) == digest(maximum=3)

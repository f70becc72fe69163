"""A tool's operation is declared beside the tool, by a decorator or in TOML, and a wrong declaration never serves."""

import tomllib
from typing import Annotated, Any, Literal

import pytest
from capabilities.values.scope import Budget, Each, Flags, Grant, Limit, OneOf, Range, Stems, Tier, Words
from capabilities.values.units import INT_LIMIT, DeclaredUnit, ListOf, Sort, Unit
from pep import Free, Length, Within, Word, grant
from pep.base.declaration import declared, operation, row_from_toml
from pep.base.fact_declaration import Fact
from pep.base.errors import DeclarationError, PepFault
from pep.base.operation_row import ArgumentForm, OperationKind
from pep.base.tier_row import TierRow
from policies.evidence.fact_reading import FactReading

SCALE = 10


@operation("valve-7", base_tier=2)
def open_valve(
    valve: Annotated[int, Within(1, 12)],
    percent: Annotated[float, Within(0, 1_000, "permille", scale=SCALE, above={800: 3, 950: 4})],
    bleed: bool,
    at: Annotated[list[float], Within(-5_000, 5_000, "um", elements=2, below={-4_000: 3})],
) -> str:
    """Open a valve."""
    return f"{valve} {percent} {bleed} {at}"


TEXT = """
object = "valve-7"
base_tier = 2
[arguments]
valve = { low = 1, high = 12, integer = true }
percent = { low = 0, high = 1000, unit = "permille", scale = 10, above = { 800 = 3, 950 = 4 } }
bleed = "flag"
at = { low = -5000, high = 5000, unit = "um", elements = 2, below = { -4000 = 3 } }
"""


def test_both_spellings_are_one_row():
    row = declared(open_valve)
    assert row == row_from_toml("open_valve", tomllib.loads(TEXT))
    assert (row.object, row.name, row.kind, row.base_tier) == ("valve-7", "open_valve", OperationKind.ACT, 2)
    assert row.robot is None
    assert [(a.name, a.form, a.parameters) for a in row.arguments] == [
        ("valve", ArgumentForm.INTEGER, 1), ("percent", ArgumentForm.NUMBER, 1),
        ("bleed", ArgumentForm.VALUE, 1), ("at", ArgumentForm.VECTOR, 2),
    ]  # fmt: skip
    assert [(p.name, p.kind) for p in row.parameters] == [
        ("valve", Unit.COUNT), ("percent", Unit.PERMILLE), ("bleed", Sort.FLAG),
        ("at_0", Unit.MICROMETRE), ("at_1", Unit.MICROMETRE),
    ]  # fmt: skip
    percent, at = row.limits[1], row.limits[3]
    assert (percent.bound, percent.scale, percent.exact) == (Range(0, 1_000), SCALE, False)
    assert percent.tiers == (TierRow(Range(801, 1_000), Tier(3)), TierRow(Range(951, 1_000), Tier(4)))
    assert (at.scale, at.tiers) == (1_000_000, (TierRow(Range(-5_000, -4_001), Tier(3)),))
    assert row.limits[0].exact, "what is counted is never rounded"


def test_a_free_text_is_spelled_both_ways():
    @operation("docs", base_tier=1)
    def write(content: Annotated[str, Free(64, text=True)]) -> str:
        return content

    stated = {"content": {"kind": "free", "most_bytes": 64, "text": True}}
    assert declared(write) == row_from_toml("write", {"object": "docs", "base_tier": 1, "arguments": stated})
    assert declared(write).arguments[0].form is ArgumentForm.TEXT
    with pytest.raises(DeclarationError) as refused:

        @operation("docs", base_tier=1)
        def other(content: Annotated[dict[str, Any], Free(64, text=True)]) -> None: ...

    assert refused.value.code is PepFault.DECLARATION_MALFORMED
    stated["content"]["text"] = "yes"
    with pytest.raises(DeclarationError):
        row_from_toml("write", {"object": "docs", "base_tier": 1, "arguments": stated})


def test_the_function_stays_as_it_is():
    assert open_valve(1, 2.5, bleed=True, at=[0.0, 0.0]) == "1 2.5 True [0.0, 0.0]"


def test_an_operation_of_tier_0_reads():
    @operation("plant", base_tier=0)
    def read_sensor(id: Annotated[int, Within(1, 99)]) -> float:  # noqa: A002
        return 0.0 * id

    assert declared(read_sensor).kind is OperationKind.READ


@pytest.mark.parametrize("exact", [False, True])
def test_a_row_may_be_exact(exact):
    @operation("agv", base_tier=2, exact=exact)
    def move(x: Annotated[float, Within(0, 9, "um")]) -> None: ...

    assert declared(move).limits[0].exact is exact


ANY = Stems(frozenset({""}), "")
BAR = DeclaredUnit("x-bar", 1_000)
KINDS = {
    "text": (str, "text", Sort.TEXT, ANY),
    "one of": (Literal["a", "b"], {"kind": "text", "one_of": ["b", "a"]}, Sort.TEXT, Words(frozenset("ab"))),
    "starts with": (
        Annotated[str, Word(starts_with=["ab", "abc"])],
        {"kind": "text", "starts_with": ["ab"]},
        Sort.TEXT,
        Stems(frozenset({"ab"}), ""),
    ),
    "path": (
        Annotated[str, Word("path", under=["/srv"])],
        {"kind": "path", "under": ["/srv"]},
        Sort.PATH,
        Stems(frozenset({"/srv"}), "/"),
    ),
    "url": (Annotated[str, Word("url")], "url", Sort.URL, Stems(frozenset({""}), "/")),
    "free": (Annotated[dict[str, Any], Free(64)], {"kind": "free", "most_bytes": 64}, Sort.FREE, Range(1, 64)),
    "flags": (list[bool], {"kind": "flag", "list": [0, 256]}, ListOf(Sort.FLAG), Each(Flags({True, False}), 0, 256)),
    "texts": (
        Annotated[list[str], Length(1, 3)],
        {"kind": "text", "list": [1, 3]},
        ListOf(Sort.TEXT),
        Each(ANY, 1, 3),
    ),
    "own unit": (
        Annotated[float, Within(0, 6_000, "x-bar", scale=1_000)],
        {"low": 0, "high": 6_000, "unit": "x-bar", "scale": 1_000},
        BAR,
        Range(0, 6_000),
    ),
    "numbers": (
        Annotated[list[float], Within(0, 9, "x-bar", scale=1_000), Length(0, 2)],
        {"low": 0, "high": 9, "unit": "x-bar", "scale": 1_000, "list": [0, 2]},
        ListOf(BAR),
        Each(Range(0, 9), 0, 2),
    ),
    "set": (Literal[1, 4], {"one_of": [1, 4], "integer": True}, Unit.COUNT, OneOf(frozenset({1, 4}))),
    "set of a unit": (
        Annotated[float, Within(one_of=(5, 10), unit="permille", scale=10)],
        {"one_of": [5, 10], "unit": "permille", "scale": 10},
        Unit.PERMILLE,
        OneOf(frozenset({5, 10})),
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_is_declared_by_annotation_and_by_row(name):
    hint, stated, kind, bound = KINDS[name]

    def tool(x): ...

    tool.__annotations__ = {"x": hint}
    row = declared(operation("thing", base_tier=1)(tool))
    assert row == row_from_toml("tool", {"object": "thing", "base_tier": 1, "arguments": {"x": stated}})
    ((parameter, found),) = [(limit.parameter, limit.bound) for limit in row.limits]
    assert (parameter.name, parameter.kind, found) == ("x", kind, bound)


@pytest.mark.parametrize(
    ("stated", "exact"),
    [
        (Within(0, 9, "um"), False),
        (Within(0, 9, "x-bar", scale=10), True),
        (Within(0, 9, "x-bar", scale=10, exact=False), False),
        (Within(one_of=(1, 5), unit="um"), True),
        (Within(one_of=(1, 5), unit="um", exact=False), True),
    ],
)
def test_a_set_and_a_unit_of_ones_own_are_exact(stated, exact):
    @operation("agv", base_tier=2)
    def move(x: Annotated[float, stated]) -> None: ...

    assert declared(move).limits[0].exact is exact


@pytest.mark.parametrize(
    "hint",
    [
        Annotated[int, Word()], Annotated[str, Within(0, 1)], Annotated[str, Free(9)], Annotated[dict[str, int], Free(9)], Annotated[str, Length()],
        Annotated[str, Word(), Word("path")], Annotated[list[str], Length(), Length()], Annotated[list[dict], Word()],
        Annotated[list[int], Within(0, 1, elements=2)], Annotated[dict, Length()],
    ],
)  # fmt: skip
def test_an_annotation_that_does_not_go_with_its_type_is_refused(hint):
    def tool(x): ...

    tool.__annotations__ = {"x": hint}
    with pytest.raises(DeclarationError) as refused:
        operation("thing", base_tier=1)(tool)
    assert (refused.value.code, "tool.x" in refused.value.detail) == (PepFault.DECLARATION_MALFORMED, True)


WRONG = {
    "unit of one's own without scale": ({"low": 0, "high": 1, "unit": "x-bar"}, PepFault.SCALE_INVALID),
    "unit of one's own of scale 0": ({"low": 0, "high": 1, "unit": "x-bar", "scale": 0}, PepFault.SCALE_INVALID),
    "unit of a wrong name": ({"low": 0, "high": 1, "unit": "x-Bar", "scale": 1}, PepFault.UNIT_UNKNOWN),
    "unit with its scale": ({"low": 0, "high": 1, "unit": "x-bar/10", "scale": 10}, PepFault.UNIT_UNKNOWN),
    "set and bounds": ({"low": 0, "high": 1, "one_of": [1]}, PepFault.DECLARATION_MALFORMED),
    "set of fractions": ({"one_of": [0.5]}, PepFault.DECLARATION_MALFORMED),
    "large set": ({"one_of": list(range(0, 130, 2))}, PepFault.BOUND_EMPTY),
    "edge beyond the set": ({"one_of": [1, 4], "above": {"4": 3}}, PepFault.BOUND_EMPTY),
    "no such kind": ({"kind": "date"}, PepFault.DECLARATION_MALFORMED),
    "stems of a path": ({"kind": "path", "starts_with": ["/srv"]}, PepFault.DECLARATION_MALFORMED),
    "directories of a text": ({"kind": "text", "under": ["a"]}, PepFault.DECLARATION_MALFORMED),
    "two ways": ({"kind": "text", "one_of": ["a"], "starts_with": ["b"]}, PepFault.DECLARATION_MALFORMED),
    "a text for a list": ({"kind": "text", "one_of": "abc"}, PepFault.DECLARATION_MALFORMED),
    "path up": ({"kind": "path", "under": ["/srv/.."]}, PepFault.DECLARATION_MALFORMED),
    "path root": ({"kind": "path", "under": ["/"]}, PepFault.DECLARATION_MALFORMED),
    "host in capitals": ({"kind": "url", "under": ["https://A.example"]}, PepFault.DECLARATION_MALFORMED),
    "hidden character": ({"kind": "text", "one_of": ["a\u200b"]}, PepFault.DECLARATION_MALFORMED),
    "free of no bytes": ({"kind": "free", "most_bytes": 0}, PepFault.BOUND_EMPTY),
    "free of any size": ({"kind": "free"}, PepFault.DECLARATION_MALFORMED),
    "list of free values": ({"kind": "free", "most_bytes": 9, "list": [0, 1]}, PepFault.BOUND_EMPTY),
    "list of none": ({"kind": "text", "list": [0, 0]}, PepFault.BOUND_EMPTY),
    "list turned round": ({"kind": "text", "list": [3, 1]}, PepFault.BOUND_EMPTY),
    "very long list": ({"kind": "text", "list": [0, 257]}, PepFault.BOUND_EMPTY),
    "flag with more": ({"kind": "flag", "one_of": [True]}, PepFault.DECLARATION_MALFORMED),
    "unit": ({"low": 0, "high": 1, "unit": "furlong"}, PepFault.UNIT_UNKNOWN),
    "scale 0": ({"low": 0, "high": 1, "scale": 0}, PepFault.SCALE_INVALID),
    "scale below 0": ({"low": 0, "high": 1, "scale": -1}, PepFault.SCALE_INVALID),
    "scale true": ({"low": 0, "high": 1, "scale": True}, PepFault.SCALE_INVALID),
    "empty": ({"low": 2, "high": 1}, PepFault.BOUND_EMPTY),
    "not whole": ({"low": 0.5, "high": 1}, PepFault.BOUND_EMPTY),
    "not kept": ({"low": 0, "high": 2**53}, PepFault.BOUND_EMPTY),
    "edge outside": ({"low": 0, "high": 10, "above": {"10": 3}}, PepFault.BOUND_EMPTY),
    "edge below": ({"low": 0, "high": 10, "below": {"0": 3}}, PepFault.BOUND_EMPTY),
    "lowers": ({"low": 0, "high": 10, "above": {"5": 1}}, PepFault.ROW_LOWERS),
    "raises nothing": ({"low": 0, "high": 10, "above": {"5": 2}}, PepFault.ROW_LOWERS),
    "lowers outwards": ({"low": 0, "high": 10, "above": {"5": 4, "8": 3}}, PepFault.ROW_LOWERS),
    "lowers downwards": ({"low": 0, "high": 10, "below": {"5": 4, "3": 3}}, PepFault.ROW_LOWERS),
    "no tier": ({"low": 0, "high": 10, "above": {"5": 5}}, PepFault.DECLARATION_MALFORMED),
    "edge no number": ({"low": 0, "high": 10, "above": {"five": 3}}, PepFault.DECLARATION_MALFORMED),
    "unknown member": ({"low": 0, "high": 10, "step": 2}, PepFault.DECLARATION_MALFORMED),
    "bound missing": ({"low": 0}, PepFault.DECLARATION_MALFORMED),
    "list of integers": ({"low": 0, "high": 1, "elements": 2, "integer": True}, PepFault.DECLARATION_MALFORMED),
    "long list": ({"low": 0, "high": 1, "elements": 33}, PepFault.DECLARATION_MALFORMED),
    "other word": ("switch", PepFault.DECLARATION_MALFORMED),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_has_one_answer(name):
    stated, code = WRONG[name]
    with pytest.raises(DeclarationError) as refused:
        row_from_toml("tool", {"object": "thing", "base_tier": 2, "arguments": {"x": stated}})
    assert refused.value.code is code
    assert "tool" in refused.value.detail


@pytest.mark.parametrize(
    "table",
    [
        [], {}, {"object": "thing"}, {"object": "thing", "base_tier": 5}, {"object": "thing", "base_tier": True},
        {"object": "a b", "base_tier": 1}, {"object": "thing", "base_tier": 1, "exact": 1},
        {"object": "thing", "base_tier": 1, "arguments": []}, {"object": "thing", "base_tier": 1, "kind": "act"},
        {"object": "thing", "base_tier": 1, "arguments": {"a": {"low": 0, "high": 1, "elements": 1}, "a_0": "flag"}},
    ],
)  # fmt: skip
def test_a_table_is_read_strictly(table):
    with pytest.raises(DeclarationError) as refused:
        row_from_toml("tool", table)
    assert refused.value.code is PepFault.DECLARATION_MALFORMED


def test_an_annotation_that_is_no_number_is_refused():
    with pytest.raises(DeclarationError) as refused:

        @operation("thing", base_tier=1)
        def tool(x: Annotated[str, Within(0, 1)]) -> None: ...

    assert refused.value.code is PepFault.DECLARATION_MALFORMED


# --- facts of sensors -------------------------------------------------------------------------------------------------


@operation(
    "press",
    base_tier=1,
    when={
        "zone-a/people": Fact(at_least={1: 3, 4: 4}),
        "tank/level": Fact(at_most={100: 3, 20: 4}, unit="permille", fresh_ms=2_000),
    },
)
def close_press() -> None:
    """Close the press."""


PRESS = """
object = "press"
base_tier = 1
[when]
"zone-a/people" = { at_least = { 1 = 3, 4 = 4 } }
"tank/level" = { at_most = { 100 = 3, 20 = 4 }, unit = "permille", fresh_ms = 2000 }
"""


def test_both_spellings_of_facts_are_one_row():
    found = declared(close_press)
    assert found == row_from_toml("close_press", tomllib.loads(PRESS))
    level, people = found.facts
    assert [(each.fact, each.unit, each.fresh_ms) for each in found.facts] == [
        ("tank/level", Unit.PERMILLE, 2_000), ("zone-a/people", Unit.COUNT, 500),
    ]  # fmt: skip
    assert people.tiers == (TierRow(Range(1, INT_LIMIT), Tier(3)), TierRow(Range(4, INT_LIMIT), Tier(4)))
    assert level.tiers == (TierRow(Range(-INT_LIMIT, 20), Tier(4)), TierRow(Range(-INT_LIMIT, 100), Tier(3)))


@pytest.mark.parametrize(
    ("level", "people", "tier", "raised_by"),
    [
        (500, 0, 1, ()), (100, 0, 3, ("tank/level",)), (101, 1, 3, ("zone-a/people",)), (20, 3, 4, ("tank/level",)),
        (20, 4, 4, ("tank/level", "zone-a/people")), (None, 0, 4, ("tank/level",)), (500, None, 4, ("zone-a/people",)),
    ],
)  # fmt: skip
def test_the_highest_of_all_facts_counts_and_an_unknown_one_as_its_highest(level, people, tier, raised_by):
    readings = tuple(
        FactReading(name, "fresh", "", value, "", 1)
        for name, value in (("tank/level", level), ("zone-a/people", people))
        if value is not None
    )
    assert declared(close_press).tier_of((), readings) == (tier, raised_by)


@pytest.mark.parametrize(
    ("when", "code", "place"),
    [
        ('"people" = { at_least = { 1 = 3 } }', PepFault.DECLARATION_MALFORMED, "people"),
        ('"zone a/people" = { at_least = { 1 = 3 } }', PepFault.DECLARATION_MALFORMED, "zone a/people"),
        ('"Zone-a/people" = { at_least = { 1 = 3 } }', PepFault.DECLARATION_MALFORMED, "Zone-a/people"),
        ('"zone-a/b/people" = { at_least = { 1 = 3 } }', PepFault.DECLARATION_MALFORMED, "zone-a/b/people"),
        ('"zone-a/people" = {}', PepFault.BOUND_EMPTY, "zone-a/people"),
        ('"zone-a/people" = 3', PepFault.DECLARATION_MALFORMED, "zone-a/people"),
        ('"zone-a/people" = { above = { 1 = 3 } }', PepFault.DECLARATION_MALFORMED, "at_least"),
        ('"zone-a/people" = { at_least = 3 }', PepFault.DECLARATION_MALFORMED, "zone-a/people"),
        ('"zone-a/people" = { at_least = { many = 3 } }', PepFault.DECLARATION_MALFORMED, "zone-a/people"),
        ('"zone-a/people" = { at_least = { 1 = 5 } }', PepFault.DECLARATION_MALFORMED, "at_least"),
        ('"zone-a/people" = { at_least = { 1 = true } }', PepFault.DECLARATION_MALFORMED, "at_least"),
        ('"zone-a/people" = { at_least = { 1 = 1 } }', PepFault.ROW_LOWERS, "zone-a/people"),
        ('"zone-a/people" = { at_least = { 1 = 4, 2 = 3 } }', PepFault.ROW_LOWERS, "zone-a/people"),
        ('"zone-a/people" = { at_most = { 1 = 4, 2 = 4 } }', PepFault.ROW_LOWERS, "zone-a/people"),
        ('"zone-a/people" = { at_least = { 1 = 3 }, unit = "cats" }', PepFault.UNIT_UNKNOWN, "zone-a/people"),
        ('"zone-a/people" = { at_least = { 1 = 3 }, fresh_ms = 0 }', PepFault.BOUND_EMPTY, "fresh_ms"),
        ('"zone-a/people" = { at_least = { 1 = 3 }, fresh_ms = 60001 }', PepFault.BOUND_EMPTY, "fresh_ms"),
        ('"zone-a/people" = { at_least = { 9007199254740992 = 3 } }', PepFault.DECLARATION_MALFORMED, "at_least"),
    ],
)
def test_a_wrong_fact_never_serves(when, code, place):
    table = tomllib.loads(f'object = "press"\nbase_tier = 1\n[when]\n{when}')
    with pytest.raises(DeclarationError) as refused:
        row_from_toml("close_press", table)
    assert (refused.value.code, "close_press.when" in refused.value.detail) == (code, True)
    assert place in refused.value.detail


@pytest.mark.parametrize("state", ["stale", "missing", "invalid"])
def test_a_value_that_is_not_fresh_is_as_none(state):
    readings = (FactReading("tank/level", "fresh", "", 500, "", 1), FactReading("zone-a/people", state, "", 0, "", 9))
    assert declared(close_press).tier_of((), readings) == (4, ("zone-a/people",))


def test_a_grant_is_as_wide_as_the_row_but_for_the_named_bounds():
    row = declared(open_valve)
    acts, quick = Budget("", "https://plant.example/mcp", 3_600, 20), Budget("", "https://plant.example/mcp", 60, 2)
    assert grant(open_valve) == Grant("valve-7", "open_valve", tuple(Limit(b.parameter, b.bound) for b in row.limits))
    less = grant(row, acts, quick, percent=Range(0, 400), bleed=Flags(frozenset({False})))
    assert [limit.bound for limit in less.limits] == [
        Range(1, 12), Range(0, 400), Flags(frozenset({False})), Range(-5_000, 5_000), Range(-5_000, 5_000),
    ]  # fmt: skip
    assert less.budgets == (quick, acts), "in the order of the wire"


@pytest.mark.parametrize(
    ("function", "tighter", "code", "where"),
    [
        (len, {}, PepFault.TOOL_UNDECLARED, "len"),
        (open_valve, {"opening": Range(0, 1)}, PepFault.DECLARATION_MALFORMED, "open_valve.opening"),
        (open_valve, {"percent": Range(0, 1_001)}, PepFault.DECLARATION_MALFORMED, "open_valve.percent"),
        (open_valve, {"percent": Range(5, 4)}, PepFault.DECLARATION_MALFORMED, "open_valve.percent"),
        (open_valve, {"percent": Words(frozenset({"7"}))}, PepFault.DECLARATION_MALFORMED, "open_valve.percent"),
        (open_valve, {"bleed": Range(0, 1)}, PepFault.DECLARATION_MALFORMED, "open_valve.bleed"),
        (open_valve, {"percent": 400}, PepFault.DECLARATION_MALFORMED, "open_valve.percent"),
    ],
)
def test_a_grant_that_the_row_does_not_have_is_refused(function, tighter, code, where):
    with pytest.raises(DeclarationError) as refused:
        grant(function, **tighter)
    assert (refused.value.code, refused.value.detail.startswith(where)) == (code, True)

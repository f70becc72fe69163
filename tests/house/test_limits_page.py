"""The page on limits is executed: each value, each limit, each hop in its tables, and its program."""

import json
from pathlib import Path

import pytest
from capabilities.values.arguments import argument, measured
from capabilities.values.bounds import meet, nearest, permits, within
from capabilities.values.errors import CapabilityError
from capabilities.values.scope_json import restriction_from_json
from capabilities.values.units import Sort, kind_of
from tests.house.pages import BLOCK, code, rows

PAGE = (Path(__file__).parents[2] / "docs" / "limits.md").read_text("utf-8")
VALUES = rows(PAGE, "kind", "values", "refused")
LIMITS = rows(PAGE, "limit", "inside", "outside", "nearest")
HOPS = rows(PAGE, "parent", "hop", "what holds")


def limit(text):
    stated = {"object": "o", "operation": "p", "limits": [{"parameter": "x", **json.loads(text)}]}
    return restriction_from_json({"grants": [stated]}).grants[0].limits[0]


def given(kind, text):
    return argument("x", kind, json.loads(text))


def listed(cell):
    return code(cell)


@pytest.mark.parametrize("row", VALUES, ids=lambda row: row[0])
def test_a_value_has_one_spelling(row):
    for spelled in code(row[0]):
        for text in listed(row[1]):
            given(kind_of(spelled), text)
        for text in listed(row[2]):
            with pytest.raises(CapabilityError):
                given(kind_of(spelled), text)


def test_the_page_has_values_and_limits_of_every_kind():
    assert {*Sort} <= {kind for row in VALUES for kind in code(row[0])}
    kinds = {limit(code(row[0])[0]).parameter.kind for row in LIMITS}
    assert {*Sort} <= kinds and len(kinds) > len(Sort) + 1


@pytest.mark.parametrize("row", LIMITS, ids=lambda row: row[0])
def test_a_limit_has_these_values_inside(row):
    stated = limit(code(row[0])[0])
    kind = stated.parameter.kind
    inside, outside = ([measured(given(kind, text)) for text in listed(cell)] for cell in row[1:3])
    assert inside and all(permits(stated.bound, value) for value in inside)
    assert not any(permits(stated.bound, value) for value in outside)
    if outside:
        near = None if kind is Sort.FREE else nearest(stated.bound, outside[0])
        assert json.loads(json.dumps(near)) == json.loads(code(row[3])[0])


@pytest.mark.parametrize("row", HOPS, ids=lambda row: " ".join(row[:2]))
def test_a_hop_is_inside_its_parent_or_is_refused(row):
    (parent, hop), holds = (limit(code(cell)[0]) for cell in row[:2]), code(row[2])[0]
    narrower = parent.parameter == hop.parameter and within(hop.bound, parent.bound)
    assert narrower is (holds != "NOT_NARROWER")
    if narrower:
        assert meet(parent.bound, hop.bound) == hop.bound == limit(holds).bound


def test_the_program_of_the_page_runs():
    (program,) = (text for kind, text in BLOCK.findall(PAGE) if kind == "python")
    exec(compile(program, "docs/limits.md", "exec"), {"__name__": "page"})  # noqa: S102 - the page itself

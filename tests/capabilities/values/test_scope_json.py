"""The wire form of scopes: one spelling, strict both ways."""

from __future__ import annotations

import copy

import pytest
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.scope import Restriction
from capabilities.values.scope_json import restriction_from_json, restriction_to_json, scope_from_json, scope_to_json
from capabilities.values.units import INT_LIMIT
from tests.capabilities.world import QUIETER, SCOPE, SLOWER

pytestmark = pytest.mark.clause("VAL-13")


def test_examples_come_back():
    assert scope_from_json(scope_to_json(SCOPE)) == SCOPE
    for restriction in (SLOWER, QUIETER, Restriction()):
        assert restriction_from_json(restriction_to_json(restriction)) == restriction


def changed(path: tuple[object, ...], value: object) -> dict:
    wire = copy.deepcopy(scope_to_json(SCOPE))
    at = wire
    for step in path[:-1]:
        at = at[step]
    if value is KeyError:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return wire


BAD = [
    (("ceiling",), KeyError),
    (("extra",), 1),
    (("ceiling",), True),
    (("ceiling",), 5),
    (("ceiling",), -1),
    (("ceiling",), 2.0),
    (("ceiling",), "2"),
    (("depth",), -1),
    (("depth",), 9),
    (("depth",), True),
    (("depth",), None),
    (("not_after",), 0),
    (("not_after",), 10**12),
    (("not_before",), 1.5),
    (("audiences",), []),
    (("audiences",), ["http://127.0.0.1:9000/mcp", "http://127.0.0.1:9000/mcp"]),
    (("audiences",), ["http://b.example/x", "http://a.example/x"]),
    (("audiences",), ["HTTP://a.example/x"]),
    (("audiences",), ["http://a.example/x/"]),
    (("audiences",), ["http://a.example:80/x"]),
    (("audiences",), ["http://u@a.example/x"]),
    (("audiences",), ["http://a.example/x?y"]),
    (("audiences",), ["http://a.example/x#y"]),
    (("audiences",), ["http://a.example/../x"]),
    (("audiences",), ["http://a.example./x"]),
    (("audiences",), ["http://ä.example/x"]),
    (("audiences",), ["http://a.example:99999/x"]),
    (("audiences",), ["http://[::1/x"]),
    (("audiences",), "http://a.example/x"),
    (("delegates",), [1]),
    (("delegates",), ["a b"]),
    (("delegates",), ["role:"]),
    (("delegates",), ["role::x"]),
    (("delegates",), ["а"]),  # Cyrillic
    (("grants",), []),
    (("grants",), {}),
    (("grants", 0, "object"), ""),
    (("grants", 0, "object"), "ur3e\n"),
    (("grants", 0, "object"), "x" * 257),
    (("grants", 0, "operation"), "zzz"),  # no longer sorted
    (("grants", 0, "extra"), 1),
    (("grants", 0, "limits", 0, "unit"), "furlong"),
    (("grants", 0, "limits", 0, "low"), 85_001),
    (("grants", 0, "limits", 0, "low"), -INT_LIMIT - 1),
    (("grants", 0, "limits", 0, "high"), INT_LIMIT + 1),
    (("grants", 0, "limits", 0, "high"), float("nan")),
    (("grants", 0, "limits", 0, "high"), float("inf")),
    (("grants", 0, "limits", 0, "high"), KeyError),
    (("grants", 0, "limits", 0, "one_of"), [1]),
    (("grants", 0, "limits", 1, "one_of"), []),
    (("grants", 0, "limits", 1, "one_of"), [20, 10]),
    (("grants", 0, "limits", 1, "one_of"), [10, 10]),
    (("grants", 0, "limits", 1, "one_of"), [10]),
    (("grants", 0, "limits", 1, "one_of"), [10, 11, 12]),
    (("grants", 0, "limits", 1, "one_of"), [True, 10]),
    (("grants", 0, "limits", 1, "one_of"), [10, 20.0]),
    (("grants", 0, "limits", 1, "one_of"), list(range(65))),
    (("grants", 0, "limits", 1, "parameter"), "width"),  # twice
    (("grants", 0), None),
    (("grants", 1, "operation"), "gripper_move"),  # twice
]


@pytest.mark.parametrize(("path", "value"), BAD)
def test_anything_else_is_refused(path, value):
    with pytest.raises(ScopeError) as caught:
        scope_from_json(changed(path, value))
    assert caught.value.code in {FaultCode.STATEMENT_MALFORMED, FaultCode.OUT_OF_RANGE}


@pytest.mark.clause("VAL-11", "VAL-13")
@pytest.mark.parametrize(
    "value", [None, [], "x", 1, {1: 2}, {"grants": None}, {"unknown": 1}, {"grants": []}, {"audiences": []}]
)
def test_a_bad_restriction_is_refused(value):
    with pytest.raises(ScopeError) as caught:
        restriction_from_json(value)
    assert caught.value.code in {FaultCode.STATEMENT_MALFORMED, FaultCode.OUT_OF_RANGE}


@pytest.mark.clause("VAL-10", "VAL-13")
def test_too_many_grants_are_refused():
    wire = scope_to_json(SCOPE)
    wire["grants"] = [{"object": "a", "operation": f"o{i:03}", "limits": []} for i in range(65)]
    with pytest.raises(ScopeError) as caught:
        scope_from_json(wire)
    assert caught.value.code is FaultCode.OUT_OF_RANGE

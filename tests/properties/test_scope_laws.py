"""The laws of the scope algebra, asked of drawn scopes. `evaluation.tokens.campaigns.laws` says what each one is."""

from __future__ import annotations

import json
from collections import Counter

import pytest
import rfc8785
from capabilities.values.algebra import COUNTED, apply, hop, meet, narrows, stated
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.explanation import difference, explain, explanation_to_json, narrowable, repair
from capabilities.values.scope import Budget, Each, Flags, OneOf, Range, Scope, Stems, Words
from capabilities.values.scope_json import restriction_from_json, restriction_to_json, scope_from_json, scope_to_json
from capabilities.values.well_formed import well_formed, well_formed_restriction
from evaluation.tokens.campaigns import hop_laws, laws
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from tests.properties.drawn import (
    OTHERS,
    UNIVERSE,
    bounds_near,
    bounds_of,
    bounds_of_near,
    edges,
    families,
    hops,
    kind_edges,
    loose_bounds,
    numbers,
    requests,
    restrictions,
    scopes,
)
from tests.properties.drawn import bounds as any_bounds

from capabilities.values import bounds, budgets

pytestmark = pytest.mark.long


@st.composite
def touching(draw, count):
    """Bounds at the edges of one another."""
    found = [draw(any_bounds)]
    while len(found) < count:
        found.append(draw(bounds_near(found[-1])))
    return tuple(draw(st.permutations(found)))


@pytest.mark.clause("VAL-8")
@given(touching(3), st.data())
def test_bounds(three, data):
    a, b, c = three
    at = st.sampled_from([value for bound in three for value in edges(bound)]) | numbers
    value, other = data.draw(at), data.draw(at)
    assert laws.meet_is_the_intersection(a, b, value)
    assert laws.meet_is_the_greatest_below_both(a, b, c)
    assert laws.meet_commutes(a, b)
    assert laws.meet_associates(a, b, c)
    assert laws.meet_is_monotone(a, b, c)
    assert laws.within_is_subset(a, b, value)
    assert laws.within_is_antisymmetric(a, b)
    assert laws.within_is_transitive(a, b, c)
    assert laws.less_is_left_out(a, b)
    assert laws.nearest_is_nearest(a, value, other)
    assert laws.nearest_bound_is_nearest(a, b, value, other)


@st.composite
def touching_of_a_kind(draw):
    """Three bounds of one kind, at the edges of one another, and two values there."""
    kind = draw(st.sampled_from([parameter.kind for parameter in OTHERS]))
    found = [draw(bounds_of(kind))]
    while len(found) < 3:
        found.append(draw(bounds_of_near(kind, found[-1])))
    at = st.sampled_from([value for bound in found for value in kind_edges(kind, bound)])
    return (*draw(st.permutations(found)), draw(at))


@pytest.mark.clause("VAL-19")
@given(touching_of_a_kind())
def test_bounds_of_every_kind(drawn):
    a, b, c, value = drawn
    assert laws.meet_is_the_intersection(a, b, value)
    assert laws.meet_is_the_greatest_below_both(a, b, c)
    assert laws.meet_commutes(a, b)
    assert laws.meet_associates(a, b, c)
    assert laws.meet_is_monotone(a, b, c)
    assert laws.within_is_subset(a, b, value)
    assert laws.within_is_antisymmetric(a, b)
    assert laws.within_is_transitive(a, b, c)
    assert laws.less_is_left_out(a, b)
    assert laws.every_nearest_is_inside(a, b, value)


@pytest.mark.clause("VAL-19")
@given(st.lists(st.sampled_from([parameter.kind for parameter in OTHERS]), min_size=2, max_size=2), st.data())
def test_bounds_of_two_kinds_have_nothing_in_common(kinds, data):
    a, b = (data.draw(bounds_of(kind)) for kind in kinds)
    if type(a) is not type(b) and {type(a), type(b)} != {Words, Stems} and not {type(a), type(b)} <= {Range, OneOf}:
        assert bounds.meet(a, b) is None
        assert not bounds.within(a, b)
        assert bounds.nearest_bound(a, b) is None


@pytest.mark.clause("VAL-8")
@given(any_bounds, any_bounds, st.sampled_from(UNIVERSE))
def test_bounds_are_the_sets_of_their_integers(a, b, value):
    """Against sets spelled out, inside a small universe."""

    def inside(bound):
        return {each for each in UNIVERSE if bounds.permits(bound, each)}

    small = all(edges(bound)[0] >= UNIVERSE[0] and edges(bound)[-1] <= UNIVERSE[-1] for bound in (a, b))
    if not small:
        return
    both = bounds.meet(a, b)
    assert (set() if both is None else inside(both)) == inside(a) & inside(b)
    assert bounds.within(a, b) == (inside(a) <= inside(b))
    assert bounds.size(a) == len(inside(a))
    assert (a == b) == (inside(a) == inside(b))
    assert bounds.nearest(a, value) == min(inside(a), key=lambda each: (abs(each - value), each))
    gap = min(abs(x - y) for x in inside(a) for y in inside(b))
    near = inside(bounds.nearest_bound(a, b))
    assert near == (inside(a) & inside(b) or {min(x for x in inside(a) if any(abs(x - y) == gap for y in inside(b)))})


@given(loose_bounds, loose_bounds, numbers)
def test_no_bound_is_stumbled_over(a, b, value):
    """Empty bounds and sets of consecutive integers too: the same answers by meaning, none by chance."""
    one, other = bounds.canonical(a), bounds.canonical(b)
    assert bounds.size(a) == (0 if one is None else bounds.size(one))
    assert bounds.permits(a, value) == laws.inside(one, value)
    assert bounds.within(a, b) == (one is None or (other is not None and bounds.within(one, other)))
    assert bounds.meet(a, b) == (None if one is None or other is None else bounds.meet(one, other))
    assert bounds.nearest(a, value) == (None if one is None else bounds.nearest(one, value))
    assert bounds.nearest_bound(a, b) == (None if one is None or other is None else bounds.nearest_bound(one, other))


@pytest.mark.clause("VAL-12", "VAL-15")
@given(families(3), st.data())
def test_scopes(three, data):
    a, b, c = three
    request = data.draw(requests(*three))
    assert laws.narrowing_is_an_order(a, b, c)
    assert laws.a_child_permits_no_more(a, b, request)
    assert laws.scopes_meet_in_the_intersection(a, b, request)
    assert laws.scopes_meet_in_the_greatest(a, b, c)
    assert laws.scopes_meet_in_any_order(a, b, c)
    assert laws.strict_is_less(a, b, request)
    both = meet(a, b)
    if both is not None:
        well_formed(both, DEFAULT)


@pytest.mark.clause("VAL-11", "VAL-15")
@given(hops(), st.data())
def test_hops(drawn, data):
    parent, restriction = drawn
    assert hop_laws.a_hop_is_the_meet(parent, restriction)
    assert hop_laws.a_refused_hop_asks_too_much(parent, restriction)
    assert hop_laws.repair_is_the_nearest(parent, restriction)
    assert hop_laws.every_nearest_is_permitted(parent, restriction)
    assert hop_laws.the_nearest_window_is_that_of_seconds(parent, restriction)
    child = stated(parent, restriction)
    request = data.draw(requests(parent, child))
    try:
        left = apply(parent, restriction)
    except ScopeError as error:
        assert error.code is (FaultCode.TOO_MANY_HOPS if parent.depth < 1 else FaultCode.NOT_NARROWER)
        assert parent.depth < 1 or not (laws.allowed(parent, request) and laws.allowed(child, request))
        return
    well_formed(left, DEFAULT)
    assert laws.allowed(left, request) == (laws.allowed(parent, request) and laws.allowed(child, request))
    assert stated(parent, difference(parent, left)) == left


@pytest.mark.clause("VAL-16")
@given(hops())
def test_every_refusal_is_explained(drawn):
    parent, restriction = drawn
    told, found = explain(parent, restriction), hop(parent, restriction)
    assert (told is None) == isinstance(found, Scope)
    if told is None:
        assert repair(parent, restriction) is restriction
        return
    assert told.widenings == found.widenings
    wire = explanation_to_json(told)
    assert json.loads(rfc8785.dumps(wire)) == json.loads(json.dumps(wire))
    assert len(wire["places"]) == len(told.widenings)
    assert told.sentence.endswith(".")
    assert "\n" not in told.sentence
    # Either more was asked, or nothing was taken away.
    assert bool(told.could_narrow) <= (not told.widenings)
    assert set(told.could_narrow) <= set(COUNTED)
    if told.repaired is not None:
        well_formed_restriction(told.repaired, DEFAULT)
        assert restriction_from_json(wire["repaired"]) == told.repaired


@pytest.mark.clause("VAL-16")
@given(scopes())
def test_what_could_be_narrowed_can_be(scope):
    """Some child with less in just that dimension exists, and none in the others."""
    from dataclasses import replace

    def just(value):
        match value:
            case bool():
                return Flags(frozenset({value}))
            case int():
                return Range(value, value)
            case str():
                return Words(frozenset({value}))
            case tuple():
                return bounds.canonical(Each(just(value[0]) if value else None, len(value), len(value)))

    def smaller(dimension):
        match dimension:
            case "grants":
                return [replace(scope, grants=scope.grants[1:])] if scope.grants[1:] else []
            case "ceiling":
                return [replace(scope, ceiling=scope.ceiling - 1)] if scope.ceiling else []
            case "audiences" | "delegates":
                names = sorted(getattr(scope, dimension))
                least = dimension == "audiences"
                return [replace(scope, **{dimension: frozenset(names[1:])})] if len(names) > least else []
            case "budgets":
                least = tuple(Budget("", audience, budgets.LONGEST_S, 1) for audience in sorted(scope.audiences))
                return [
                    replace(scope, grants=(*scope.grants[:g], replace(grant, budgets=own), *scope.grants[g + 1 :]))
                    for g, grant in enumerate(scope.grants)
                    for own in [budgets.meet(grant.budgets, least)]
                ]
            case "limits":
                return [
                    replace(scope, grants=(*scope.grants[:g], replace(grant, limits=limits), *scope.grants[g + 1 :]))
                    for g, grant in enumerate(scope.grants)
                    for i, limit in enumerate(grant.limits)
                    for value in kind_edges(limit.parameter.kind, limit.bound)
                    if bounds.permits(limit.bound, value) and value != ""
                    for limits in [(*grant.limits[:i], replace(limit, bound=just(value)), *grant.limits[i + 1 :])]
                ]

    for dimension in COUNTED:
        less = [child for child in smaller(dimension) if narrows(child, scope).strict == {dimension}]
        assert bool(less) == (dimension in narrowable(scope))


@pytest.mark.clause("VAL-13")
@given(scopes())
def test_a_scope_comes_back(scope):
    assert scope_from_json(json.loads(rfc8785.dumps(scope_to_json(scope)))) == scope


@pytest.mark.clause("VAL-11", "VAL-13")
@given(restrictions())
def test_a_restriction_comes_back(restriction):
    assert restriction_from_json(json.loads(rfc8785.dumps(restriction_to_json(restriction)))) == restriction


@pytest.mark.clause("VAL-13")
@given(scopes(), scopes())
def test_equal_scopes_have_equal_bytes_and_others_have_not(a, b):
    assert (a == b) == (rfc8785.dumps(scope_to_json(a)) == rfc8785.dumps(scope_to_json(b)))
    if a == b:
        assert hash(a) == hash(b)


MEMBERS = st.sampled_from(
    ["grants", "ceiling", "limits", "object", "operation", "one_of", "low", "high", "depth", "unit"]
)


def larger(inner):
    return st.lists(inner, max_size=3) | st.dictionaries(MEMBERS | st.text(max_size=3), inner, max_size=4)


@pytest.mark.clause("VAL-13")
@given(
    st.recursive(st.none() | st.booleans() | st.integers() | st.text(max_size=4) | st.floats(), larger, max_leaves=12)
)
def test_no_json_is_stumbled_over(value):
    for read in (scope_from_json, restriction_from_json):
        try:
            read(value)
        except ScopeError as error:
            assert error.code in {FaultCode.STATEMENT_MALFORMED, FaultCode.OUT_OF_RANGE}


def test_a_range_and_the_set_of_its_integers_are_one():
    parent, child = OneOf(frozenset({3, 4, 5})), Range(3, 5)
    assert bounds.canonical(parent) == child == bounds.one_of(5, 3, 4)
    assert bounds.within(child, parent)
    assert bounds.within(parent, child)
    assert bounds.size(child) == bounds.size(parent)
    with pytest.raises(ScopeError) as caught:
        restriction_from_json(
            {
                "grants": [
                    {"object": "a", "operation": "b", "limits": [{"parameter": "p", "unit": "g", "one_of": [3, 4, 5]}]}
                ]
            }
        )
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.campaign
def test_the_strategies_reach_every_case():
    """Laws that only ever see one outcome show nothing."""
    seen = Counter()

    @settings(max_examples=100, database=None, derandomize=False, deadline=None)
    @given(hops(), families(2))
    def look(drawn, two):
        parent, restriction = drawn
        found = hop(parent, restriction)
        if isinstance(found, Scope):
            seen["made"] += 1
        else:
            seen.update(f"wider {place.dimension}" for place in found.widenings)
            seen["nothing taken"] += not found.widenings
            seen["repaired" if repair(parent, restriction) else "beyond repair"] += 1
        compared = narrows(*two)
        if not compared.widenings:
            seen.update(f"strict {dimension}" for dimension in compared.strict)
            seen["equal"] += two[0] == two[1]
        seen["meet" if meet(*two) else "no meet"] += 1

    wider = {f"wider {dimension}" for dimension in (*COUNTED, "depth", "window")}
    wanted = wider | {f"strict {dimension}" for dimension in COUNTED}
    wanted |= {"made", "nothing taken", "repaired", "beyond repair", "equal", "meet", "no meet"}
    for number in range(15):
        seed(number)(look)()
        if all(seen[case] for case in wanted):
            return
    assert {case for case in wanted if not seen[case]} == set()

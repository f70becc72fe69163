"""The slow twin of the scopes, itself: against counting over a small world, and against the algebra of the library."""

from __future__ import annotations

from dataclasses import replace

from capabilities.values import algebra
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Quantity, Unit
from evaluation.tokens.campaigns import twin
from evaluation.tokens.campaigns.families import integers, lay_over, whole
from hypothesis import given
from hypothesis import strategies as st

WORLD = range(-6, 7)
PARAMETERS = (Parameter("a", Unit.COUNT), Parameter("b", Unit.GRAM))
URLS = ("https://a.example", "https://b.example")
NAMES = ("x", "y", "role:z")

values = st.sets(st.sampled_from(WORLD[1:-1]), min_size=1, max_size=5)
bounds = values.map(integers) | values.map(lambda some: Range(min(some), max(some)))


@st.composite
def scopes(draw):
    grants = [
        Grant("arm", name, tuple(Limit(parameter, draw(bounds)) for parameter in PARAMETERS[:count]))
        for count, name in enumerate(("none", "one", "two"))
        if draw(st.integers(0, 3))
    ]
    start = draw(st.integers(0, 3))
    return Scope(
        grants=tuple(grants) or (Grant("arm", "none"),),
        ceiling=Tier(draw(st.integers(0, 4))),
        audiences=frozenset(draw(st.sets(st.sampled_from(URLS), min_size=1))),
        delegates=frozenset(draw(st.sets(st.sampled_from(NAMES)))),
        depth=draw(st.integers(0, 3)),
        not_before=start,
        not_after=start + draw(st.integers(1, 3)),
    )


def everything(scope):
    """All that a scope permits in a small world, one by one."""
    asked = set()
    for grant in scope.grants:
        points = [()]
        for limit in grant.limits:
            points = [(*point, value) for point in points for value in WORLD if twin.inside(limit.bound, value)]
        asked |= {
            (grant.operation, point, tier, audience, second)
            for point in points
            for tier in range(scope.ceiling + 1)
            for audience in scope.audiences
            for second in range(scope.not_before, scope.not_after)
        }
    return asked


@given(bounds, bounds)
def test_the_points_of_two_bounds_show_whether_one_sticks_out(child, parent):
    shown = any(twin.inside(child, p) and not twin.inside(parent, p) for p in twin.points(child, parent))
    assert shown is any(twin.inside(child, v) and not twin.inside(parent, v) for v in WORLD)
    assert shown is not algebra.within(child, parent)


@given(scopes(), scopes())
def test_wider_and_less_are_those_of_counting(child, parent):
    blocks = (whole(parent),)
    same_delegates = child.delegates <= parent.delegates
    assert twin.wider(blocks, child) is not (everything(child) <= everything(parent) and same_delegates)
    if not twin.wider(blocks, child):
        # The window is no dimension of strictness, so both are looked at in one and the same.
        now = {"not_before": 0, "not_after": 1}
        left = everything(replace(parent, **now)) - everything(replace(child, **now))
        assert twin.less(blocks, child) is bool(left or child.delegates < parent.delegates)


@given(scopes(), scopes())
def test_the_library_orders_scopes_as_the_twin_does(child, parent):
    found = algebra.narrows(replace(child, depth=0), replace(parent, depth=1))
    assert bool(found.widenings) is twin.wider((whole(parent),), child)
    if not found.widenings:
        assert bool(found.strict) is twin.less((whole(parent),), child)


@given(scopes(), scopes())
def test_a_hop_that_states_little_is_laid_over_as_the_library_does(held, other):
    known = {(grant.object, grant.operation) for grant in held.grants}
    kept = tuple(Grant(g.object, g.operation, g.limits[1:]) for g in other.grants if (g.object, g.operation) in known)
    for restriction in (
        Restriction(),
        Restriction(grants=kept or None, ceiling=other.ceiling),
        Restriction(audiences=other.audiences, depth=other.depth, not_before=other.not_before),
        whole(other),
    ):
        assert lay_over(held, restriction) == algebra.stated(held, restriction)


@given(scopes(), st.data())
def test_a_request_is_permitted_when_counting_finds_it(scope, data):
    counts = {"none": 0, "one": 1, "two": 2}
    operation = data.draw(st.sampled_from(sorted(counts)))
    point = tuple(data.draw(st.sampled_from(WORLD)) for _ in range(counts[operation]))
    tier, second = data.draw(st.integers(0, 4)), data.draw(st.integers(0, 7))
    audience = data.draw(st.sampled_from(URLS))
    given_values = tuple(Quantity(p.name, p.unit, value) for p, value in zip(PARAMETERS, point, strict=False))
    act = twin.TriedAct("arm", operation, given_values, Tier(tier), second, audience)
    expected = (operation, point, tier, audience, second) in everything(scope)
    assert twin.acts((whole(scope),), act) == [expected]
    assert twin.acts((whole(scope), Restriction()), act) == [expected] * 2
    for odd in (
        (*given_values, Quantity("c", Unit.COUNT, 0)),
        tuple(replace(each, unit=Unit.MILLISECOND) for each in given_values) or (Quantity("c", Unit.COUNT, 0),),
        tuple(replace(each, value=True) for each in given_values) or (Quantity("c", Unit.COUNT, 0),),
    ):
        assert twin.acts((whole(scope),), replace(act, values=odd)) == [False]


def test_depth_runs_down_by_one_or_to_what_is_stated():
    states = [Restriction(depth=4), Restriction(), Restriction(depth=1), Restriction()]
    assert [twin.depth(states[: n + 1]) for n in range(4)] == [4, 3, 1, 0]


def test_nobody_lends_to_who_holds_or_is_not_named():
    grants = (Grant("arm", "one", (Limit(PARAMETERS[0], OneOf(frozenset({1, 3}))),)),)
    scope = Scope(grants, Tier(1), frozenset(URLS), frozenset({"x", "role:z"}), 2, 0, 9)
    blocks = (whole(scope), Restriction(depth=1))
    less = replace(scope, audiences=frozenset(URLS[:1]), depth=0)
    assert twin.lends(blocks, ["a", "b"], twin.Lend("x", "", less)) == [True, True]
    assert twin.lends(blocks, ["a", "b"], twin.Lend("x", "", replace(less, depth=1))) == [True, False]
    assert twin.lends(blocks, ["a", "b"], twin.Lend("y", "z", less)) == [True, True]
    assert twin.lends(blocks, ["a", "b"], twin.Lend("y", "", less)) == [False, False]
    assert twin.lends(blocks, ["a", "x"], twin.Lend("x", "", less)) == [True, False]
    assert twin.lends(blocks, ["a", "b"], twin.Lend("x", "", replace(scope, depth=0))) == [False, False]

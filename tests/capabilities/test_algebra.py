"""The laws of the scope algebra."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capabilities import algebra
from capabilities.algebra import apply, meet, narrows, permits, stated, within
from capabilities.caps import DEFAULT
from capabilities.errors import CapabilityError, FaultCode, ScopeError, TokenError
from capabilities.scope import Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.units import Parameter, Unit
from tests.capabilities.world import CELL, MOVE, NOW, OTHER_CELL, READ, SCOPE, SLOWER, SPEED

small = st.integers(-8, 8)
ranges = st.tuples(small, small).map(lambda ends: Range(min(ends), max(ends)))
sets = st.frozensets(small, min_size=1, max_size=6).map(OneOf)
bounds = ranges | sets
UNIVERSE = range(-10, 11)
PARAMETERS = tuple(Parameter(f"p{i}", Unit.COUNT) for i in range(3))
OPERATIONS = {"a": 0, "b": 1, "c": 2, "d": 3}


def inside(bound: object) -> set[int]:
    return set() if bound is None else {value for value in UNIVERSE if permits(bound, value)}


@st.composite
def scopes(draw: st.DrawFn) -> Scope:
    names = sorted(draw(st.sets(st.sampled_from(sorted(OPERATIONS)), min_size=1)))
    grants = tuple(
        Grant("arm", name, tuple(Limit(PARAMETERS[i], draw(bounds)) for i in range(OPERATIONS[name]))) for name in names
    )
    start = draw(st.integers(0, 20))
    return Scope(
        grants=grants,
        ceiling=draw(st.sampled_from(Tier)),
        audiences=draw(st.frozensets(st.sampled_from([CELL, OTHER_CELL]), min_size=1)),
        delegates=draw(st.frozensets(st.sampled_from(["x", "y", "role:z"]))),
        depth=draw(st.integers(0, DEFAULT.hops)),
        not_before=start,
        not_after=start + draw(st.integers(1, 20)),
    )


@st.composite
def restrictions(draw: st.DrawFn) -> Restriction:
    other = draw(scopes())
    kept = {name: draw(st.booleans()) for name in Restriction.__dataclass_fields__}
    thinned = tuple(
        Grant(grant.object, grant.operation, tuple(limit for limit in grant.limits if draw(st.booleans())))
        for grant in other.grants
    )
    values = {name: (thinned if name == "grants" else getattr(other, name)) for name, keep in kept.items() if keep}
    return Restriction(**values)


@given(bounds, bounds)
def test_meet_is_commutative_and_is_the_intersection(a, b):
    assert meet(a, b) == meet(b, a)
    assert inside(meet(a, b)) == inside(a) & inside(b)


@given(bounds, bounds, bounds)
def test_meet_is_associative(a, b, c):
    def both(x, y):
        return None if x is None or y is None else meet(x, y)

    assert both(both(a, b), c) == both(a, both(b, c))


@given(bounds)
def test_meet_is_idempotent(a):
    assert meet(a, a) == a


@given(bounds, bounds)
def test_within_is_subset_and_size_counts(a, b):
    assert within(a, b) == (inside(a) <= inside(b))
    assert algebra.size(a) == len(inside(a))
    if within(a, b):
        assert inside(meet(a, b)) == inside(a)


@given(bounds, st.integers(-12, 12))
def test_nearest_is_inside_and_nearest(bound, value):
    found = algebra.nearest(bound, value)
    assert permits(bound, found)
    assert all(abs(found - value) <= abs(other - value) for other in inside(bound))


def test_a_wide_range_is_not_walked():
    assert not within(Range(0, 2**53), OneOf(frozenset({1, 2})))


@given(scopes())
def test_narrows_is_reflexive_but_not_strictly(scope):
    found = narrows(scope, scope)
    assert found.widenings == ()
    assert found.strict == frozenset()


@given(scopes(), restrictions())
def test_apply_narrows_and_uses_up_depth(parent, restriction):
    try:
        child = apply(parent, restriction)
    except ScopeError as error:
        assert error.code in {FaultCode.NOT_NARROWER, FaultCode.TOO_MANY_HOPS}
        return
    assert narrows(child, parent).widenings == ()
    assert child.depth < parent.depth
    algebra.well_formed(child, DEFAULT)


@given(scopes(), restrictions(), restrictions())
def test_narrowing_is_transitive(parent, first, second):
    try:
        child = apply(parent, first)
        grandchild = apply(child, second)
    except ScopeError:
        return
    assert narrows(grandchild, parent).widenings == ()


@given(scopes(), restrictions())
def test_nowhere_wider_means_stated_is_what_holds(parent, restriction):
    child = stated(parent, restriction)
    if (
        narrows(child, parent).widenings
        or parent.depth < 1
        or child.depth >= parent.depth
        or child.not_before >= child.not_after
    ):
        return
    assert apply(parent, restriction) == child


def permitted(scope: Scope, operation: str, values: tuple[int, ...], tier: int, at: int, audience: str) -> bool:
    grant = next((grant for grant in scope.grants if grant.operation == operation), None)
    return (
        grant is not None
        and len(grant.limits) == len(values)
        and all(permits(limit.bound, value) for limit, value in zip(grant.limits, values, strict=True))
        and tier <= scope.ceiling
        and scope.not_before <= at < scope.not_after
        and audience in scope.audiences
    )


@settings(max_examples=400)
@given(scopes(), scopes(), st.data())
def test_whatever_a_child_permits_its_parent_permits(parent, child, data):
    if narrows(child, parent).widenings:
        return
    for operation, arity in OPERATIONS.items():
        values = tuple(data.draw(st.integers(-9, 9)) for _ in range(arity))
        tier, at = data.draw(st.integers(0, 5)), data.draw(st.integers(0, 41))
        for audience in (CELL, OTHER_CELL):
            if permitted(child, operation, values, tier, at, audience):
                assert permitted(parent, operation, values, tier, at, audience)


@settings(max_examples=300)
@given(scopes(), restrictions(), st.data())
def test_apply_permits_exactly_what_parent_and_restriction_both_permit(parent, restriction, data):
    try:
        child = apply(parent, restriction)
    except ScopeError:
        return
    wanted = stated(parent, restriction)
    for operation, arity in OPERATIONS.items():
        values = tuple(data.draw(st.integers(-9, 9)) for _ in range(arity))
        request = (operation, values, data.draw(st.integers(0, 5)), data.draw(st.integers(0, 41)), CELL)
        assert permitted(child, *request) == (permitted(parent, *request) and permitted(wanted, *request))


@pytest.mark.parametrize(
    ("restriction", "dimension"),
    [
        (Restriction(grants=(Grant("ur3e", "set_payload"),)), "grants"),
        (Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(1, 1_000_001)),)),)), "limits"),
        (Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(0, 10)),)),)), "limits"),
        (
            Restriction(
                grants=(
                    Grant("ur3e", "move_joint", (Limit(Parameter("speed", Unit.MICROMETRE_PER_SECOND), Range(1, 2)),)),
                )
            ),
            "limits",
        ),
        (Restriction(grants=(Grant("ur3e", "read_state", (Limit(SPEED, Range(1, 2)),)),)), "limits"),
        (Restriction(ceiling=Tier.SAFETY_CRITICAL), "ceiling"),
        (Restriction(audiences=frozenset({CELL, "http://127.0.0.1:9002/mcp"})), "audiences"),
        (Restriction(delegates=frozenset({"robotic", "stranger"})), "delegates"),
        (Restriction(depth=5), "depth"),
        (Restriction(not_after=NOW + 3_001), "window"),
        (Restriction(not_before=NOW - 61), "window"),
    ],
)
def test_each_widening_is_named(restriction, dimension):
    found = narrows(stated(SCOPE, restriction), SCOPE)
    assert [widening.dimension for widening in found.widenings] == [dimension]


@pytest.mark.parametrize(
    ("restriction", "strict"),
    [
        (SLOWER, {"grants", "limits", "delegates"}),
        (Restriction(grants=(MOVE, READ)), {"grants"}),
        (Restriction(ceiling=Tier.REVERSIBLE), {"ceiling"}),
        (Restriction(audiences=frozenset({CELL})), {"audiences"}),
        (Restriction(delegates=frozenset()), {"delegates"}),
        (Restriction(depth=0, not_after=NOW + 5), set()),
        (Restriction(), set()),
    ],
)
def test_each_strict_dimension_is_named(restriction, strict):
    found = narrows(stated(SCOPE, restriction), SCOPE)
    assert found.widenings == ()
    assert found.strict == strict


def test_apply_refuses_what_leaves_nothing():
    for restriction in (
        Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(2_000_000, 3_000_000)),)),)),
        Restriction(audiences=frozenset({"http://127.0.0.1:1/mcp"})),
        Restriction(not_before=NOW + 10, not_after=NOW + 10),
        Restriction(grants=(Grant("other", "stop"),)),
    ):
        with pytest.raises(ScopeError) as caught:
            apply(SCOPE, restriction)
        assert caught.value.code is FaultCode.NOT_NARROWER


def test_the_error_tree_has_one_root():
    assert issubclass(ScopeError, CapabilityError)
    assert issubclass(TokenError, CapabilityError)

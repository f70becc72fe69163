"""The order of scopes and the rule of a hop, by example. Their laws are in tests/properties."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest
from capabilities.values.algebra import apply, hop, meet, narrows, stated, within
from capabilities.values.bounds import nearest_bound, one_of
from capabilities.values.budgets import LONGEST_S
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError, FaultCode, ScopeError, TokenError
from capabilities.values.explanation import explain, explanation_to_json, narrowable, repair
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.scope import Budget, Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Unit
from tests.capabilities.world import CELL, FORCE, JOINTS, MOVE, NOW, READ, SCOPE, SLOWER, SPEED, STOP, WIDTH

from capabilities.values import algebra

pytestmark = pytest.mark.clause("VAL-12")


@pytest.mark.clause("VAL-8")
def test_a_wide_range_is_not_walked():
    assert not within(Range(0, 2**53), OneOf(frozenset({1, 2})))


@pytest.mark.parametrize(
    ("bound", "value", "found"),
    [
        (OneOf(frozenset({3, 7})), 5, 3),
        (OneOf(frozenset({-7, -3})), -5, -7),
        (OneOf(frozenset({3, 7})), 6, 7),
        (Range(3, 7), 2, 3),
        (Range(3, 7), 8, 7),
        (Range(7, 3), 5, None),
        (OneOf(frozenset()), 5, None),
    ],
)
def test_the_lower_of_two_equally_near(bound, value, found):
    assert algebra.nearest(bound, value) == found


def test_the_lower_of_two_equally_near_bounds():
    assert nearest_bound(OneOf(frozenset({0, 10})), Range(4, 6)) == Range(0, 0)
    assert nearest_bound(Range(4, 6), OneOf(frozenset({0, 10}))) == Range(4, 4)


@pytest.mark.clause("BLK-6")
def test_what_a_hop_keeps_is_the_very_same():
    child = stated(SCOPE, SLOWER)
    assert [grant is SCOPE.find(grant.object, grant.operation) for grant in child.grants] == [False, True, True]
    assert [limit is above for limit, above in zip(child.grants[0].limits, MOVE.limits, strict=True)] == [
        True,
        True,
        False,
    ]


def test_a_grant_is_found_by_its_pair():
    assert SCOPE.find("ur3e", "stop") is STOP
    assert SCOPE.find("ur3e", "drill") is None
    assert SCOPE.find("ur5e", "stop") is None
    other = replace(SCOPE, grants=(READ,))
    assert other.find("ur3e", "stop") is None
    assert other == Scope(**{name: getattr(other, name) for name in Restriction.__dataclass_fields__})


@pytest.mark.clause("VAL-10", "TOK-6.8")
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


@pytest.mark.clause("VAL-12", "TOK-6.8")
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


@pytest.mark.clause("VAL-11")
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


def speed(bound) -> Restriction:
    return Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, bound),)), READ))


@pytest.mark.clause("VAL-16")
@pytest.mark.parametrize(
    ("restriction", "what", "nearest"),
    [
        (speed(Range(1, 1_000_001)), "ur3e/move_joint/speed", {"low": 1, "high": 1_000_000}),
        (speed(Range(1_000_001, 2_000_000)), "ur3e/move_joint/speed", {"low": 1_000_000, "high": 1_000_000}),
        (speed(Range(-9, 0)), "ur3e/move_joint/speed", {"low": 1, "high": 1}),
        (speed(one_of(0, 4, 9, 2_000_000)), "ur3e/move_joint/speed", {"one_of": [4, 9]}),
        (
            Restriction(grants=(Grant("ur3e", "gripper_move", (Limit(FORCE, Range(31, 100)),)),)),
            "ur3e/gripper_move/force",
            {"low": 40, "high": 40},
        ),
        (
            Restriction(grants=(Grant("ur3e", "gripper_move", (Limit(FORCE, Range(11, 19)),)),)),
            "ur3e/gripper_move/force",
            {"low": 10, "high": 10},
        ),
        (
            Restriction(
                grants=(Grant("ur3e", "gripper_move", (Limit(Parameter("force", Unit.GRAM), Range(1, 2)),)),),
            ),
            "ur3e/gripper_move",
            [
                {"parameter": "width", "unit": "um", "low": 0, "high": 85_000},
                {"parameter": "force", "unit": "mN", "one_of": [10, 20, 40]},
            ],
        ),
        (Restriction(grants=(Grant("ur3e", "drill"), READ)), "ur3e/drill", None),
        (Restriction(ceiling=Tier.SAFETY_CRITICAL), "ceiling", 3),
        (Restriction(audiences=frozenset({CELL, "http://127.0.0.1:9002/mcp"})), "audiences", [CELL]),
        (Restriction(audiences=frozenset({"http://127.0.0.1:9002/mcp"})), "audiences", None),
        (Restriction(delegates=frozenset({"stranger"})), "delegates", []),
        (Restriction(depth=4), "depth", 3),
        (Restriction(not_after=NOW + 9_000), "window", [NOW - 60, NOW + 3_000]),
        (Restriction(not_before=NOW + 5_000, not_after=NOW + 9_000), "window", [NOW + 2_999, NOW + 3_000]),
        (Restriction(not_before=0, not_after=5), "window", [NOW - 60, NOW - 59]),
        (Restriction(not_before=NOW, not_after=NOW, ceiling=Tier.REVERSIBLE), "window", [NOW, NOW + 1]),
    ],
)
def test_the_nearest_is_told(restriction, what, nearest):
    told = explain(SCOPE, restriction)
    assert [(place.what, place.nearest) for place in told.widenings] == [(what, nearest)]
    assert what in told.sentence or "axis" in told.sentence
    assert explanation_to_json(told)["places"][0]["nearest"] == nearest


@pytest.mark.clause("VAL-16")
def test_an_axis_is_told_by_its_vector():
    wide = Restriction(grants=(Grant("ur3e", "move_joint", (Limit(JOINTS[1], Range(0, 4_000_000)),)),))
    (place,) = explanation_to_json(explain(SCOPE, wide))["places"]
    assert (place["vector"], place["axis"], place["unit"]) == ("ur3e/move_joint/q", 1, "urad")


@pytest.mark.clause("VAL-16")
def test_the_bounds_are_told_in_the_sentence():
    sentence = explain(SCOPE, speed(Range(0, 2_000_000))).sentence
    for figure in ("ur3e/move_joint/speed", "0 to 2000000", "1 to 1000000", "urad_s"):
        assert figure in sentence


@pytest.mark.clause("VAL-16")
def test_a_long_refusal_is_one_short_sentence():
    many = Restriction(
        grants=tuple(Grant("ur3e", f"x{i:02}") for i in range(60)),
        audiences=frozenset(f"http://127.0.0.1:{port}/mcp" for port in range(1_000, 1_060)),
    )
    told = explain(SCOPE, many)
    assert len(told.widenings) == 61
    assert len(told.sentence) < 400


@pytest.mark.clause("VAL-16", "TOK-6.8")
def test_nothing_taken_away_is_told():
    told = explain(SCOPE, Restriction(depth=0, not_after=NOW + 5))
    assert told.widenings == ()
    assert told.could_narrow == ("grants", "limits", "budgets", "ceiling", "audiences", "delegates")
    assert told.could_narrow == narrowable(SCOPE)
    assert told.repaired is None
    assert all(dimension in told.sentence for dimension in told.could_narrow)
    once = replace(STOP, budgets=(Budget("", CELL, LONGEST_S, 1),))
    least = replace(SCOPE, grants=(once,), ceiling=Tier.NO_EFFECT, audiences=frozenset({CELL}), delegates=frozenset())
    assert explain(least, Restriction()).could_narrow == ()


@pytest.mark.clause("VAL-16", "TOK-6.7")
def test_no_depth_left_is_told():
    told = explain(replace(SCOPE, depth=0), SLOWER)
    assert [(place.dimension, place.nearest) for place in told.widenings] == [("depth", None)]
    assert told.repaired is None


@pytest.mark.parametrize(
    ("restriction", "repaired"),
    [
        (SLOWER, SLOWER),
        (speed(Range(0, 500_000)), speed(Range(1, 500_000))),
        (speed(Range(0, 2_000_000)), Restriction(grants=(Grant("ur3e", "move_joint"), READ))),
        (
            Restriction(grants=(Grant("ur3e", "drill"), READ), ceiling=Tier.SAFETY_CRITICAL, depth=8),
            Restriction(grants=(READ,)),
        ),
        # What has nothing in common with the parent goes, with the grant that it stands in.
        (speed(Range(2_000_000, 3_000_000)), Restriction(grants=(READ,))),
        (
            Restriction(delegates=frozenset({"vision", "stranger"}), not_after=NOW + 9_000),
            Restriction(delegates=frozenset({"vision"})),
        ),
        # Without what is too much nothing is taken away, or nothing is left.
        (Restriction(ceiling=Tier.SAFETY_CRITICAL), None),
        (Restriction(grants=(Grant("ur3e", "drill"),)), None),
        (Restriction(audiences=frozenset({"http://127.0.0.1:9002/mcp"})), None),
        (Restriction(ceiling=Tier.REVERSIBLE, not_before=NOW + 9_000, not_after=NOW + 9_009), None),
        (Restriction(), None),
    ],
)
@pytest.mark.clause("VAL-16")
def test_the_nearest_restriction_that_is_accepted(restriction, repaired):
    assert repair(SCOPE, restriction) == repaired
    if repaired is not None:
        assert isinstance(hop(SCOPE, repaired), Scope)


def test_an_equal_set_is_not_less():
    """A parent with a set and a child with the range of the same integers are equal, either way."""
    three = replace(SCOPE, grants=(Grant("ur3e", "gripper_move", (Limit(WIDTH, OneOf(frozenset({3, 4, 5}))),)),))
    span = replace(SCOPE, grants=(Grant("ur3e", "gripper_move", (Limit(WIDTH, Range(3, 5)),)),))
    for child, parent in ((three, span), (span, three)):
        found = narrows(child, parent)
        assert (found.widenings, found.strict) == ((), frozenset())
    assert meet(three, span) == span
    with pytest.raises(ScopeError) as caught:
        algebra.well_formed(three, DEFAULT)
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.parametrize(
    "limits",
    [
        (MOVE.limits[1], MOVE.limits[0], MOVE.limits[2]),
        (*MOVE.limits[:2], Limit(Parameter("velocity", SPEED.unit), MOVE.limits[2].bound)),
        (*MOVE.limits[:2], Limit(Parameter("speed", Unit.MICROMETRE_PER_SECOND), MOVE.limits[2].bound)),
        MOVE.limits[:2],
        (),
    ],
)
def test_another_signature_is_another_operation(limits):
    """The order, a name, a unit, the number of parameters: none may change, even where each bound is inside."""
    child = replace(SCOPE, grants=(replace(MOVE, limits=limits),))
    assert [place.what for place in narrows(child, SCOPE).widenings] == ["ur3e/move_joint"]
    assert meet(child, SCOPE) is None


@pytest.mark.clause("VAL-15")
def test_another_signature_meets_in_nothing():
    other = replace(SCOPE, grants=(Grant("ur3e", "stop", (Limit(SPEED, Range(1, 2)),)),))
    assert meet(other, replace(SCOPE, grants=(STOP,))) is None


@pytest.mark.clause(reason="the shape of our errors")
def test_the_error_tree_has_one_root():
    assert issubclass(ScopeError, CapabilityError)
    assert issubclass(TokenError, CapabilityError)


@pytest.mark.clause(reason="library plumbing: what is remembered by grants is remembered in one process")
def test_a_hash_does_not_leave_its_process():
    assert hash(MOVE) == hash(replace(MOVE))
    came = pickle.loads(pickle.dumps(MOVE))
    assert came == MOVE
    assert came._hash == 0
    assert hash(came) == hash(MOVE)


@pytest.mark.clause(reason="library plumbing: what is remembered by grants is remembered in one process")
def test_a_hashed_tuple_is_found_where_the_plain_one_is():
    plain = (MOVE, STOP)
    hashed = HashedTuple(plain)
    assert hashed == plain
    assert hash(hashed) == hash(hashed) == hash(plain)
    assert {plain: 1}[hashed] == {hashed: 1}[plain] == 1
    assert HashedTuple((STOP, MOVE)) != hashed
    came = pickle.loads(pickle.dumps(hashed))
    assert type(came) is tuple
    assert came == hashed

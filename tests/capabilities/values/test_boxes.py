"""Vector parameters: one limit for each axis."""

from __future__ import annotations

import pytest
from capabilities.values.boxes import VectorParameter, box, boxes_of
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.scope import Grant, Limit, Range
from capabilities.values.units import Parameter, Unit
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import MOVE, SPEED

pytestmark = pytest.mark.clause("VAL-9")

TURN = Limit(Parameter("r0", Unit.MICRORADIAN), Range(0, 1))


def test_a_box_is_one_limit_for_each_axis():
    made = box("q", Unit.MICRORADIAN, [-3_000_000] * 2, [3_000_000] * 2)
    assert Grant("ur3e", "move_joint", (*made, MOVE.limits[-1])) == MOVE
    assert boxes_of(MOVE) == (VectorParameter("q", Unit.MICRORADIAN, (Range(-3_000_000, 3_000_000),) * 2),)


@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(0, 9)), min_size=2, max_size=12),
    st.sampled_from(["q", "x_", "p1_"]),
)
def test_a_box_comes_back(axes, name):
    lows, highs = [low for low, _ in axes], [low + more for low, more in axes]
    grant = Grant("arm", "move", (Limit(SPEED, Range(0, 1)), *box(name, Unit.MICROMETRE, lows, highs), TURN))
    (found,) = boxes_of(grant)
    assert found == VectorParameter(name, Unit.MICROMETRE, tuple(map(Range, lows, highs)))


def test_a_pose_is_two_boxes():
    pose = (*box("x", Unit.MICROMETRE, [0] * 3, [9] * 3), *box("r", Unit.MICRORADIAN, [0] * 3, [9] * 3))
    assert [(found.name, len(found.bounds)) for found in boxes_of(Grant("arm", "move", pose))] == [("x", 3), ("r", 3)]


def limits(*named):
    return tuple(Limit(Parameter(name, unit), Range(0, 1)) for name, unit in named)


@pytest.mark.parametrize(
    "found",
    [
        limits(("q0", Unit.COUNT)),
        limits(("q1", Unit.COUNT), ("q2", Unit.COUNT)),
        limits(("q0", Unit.COUNT), ("q2", Unit.COUNT)),
        limits(("q0", Unit.COUNT), ("q1", Unit.GRAM)),
        limits(("q0", Unit.COUNT), ("speed", Unit.COUNT), ("q1", Unit.COUNT)),
        limits(("q0", Unit.COUNT), ("r1", Unit.COUNT)),
        limits(("0", Unit.COUNT), ("1", Unit.COUNT)),
    ],
)
def test_others_are_no_box(found):
    assert boxes_of(Grant("arm", "move", found)) == ()


@pytest.mark.parametrize(
    ("lows", "highs", "name", "code"),
    [
        ([], [], "q", FaultCode.STATEMENT_MALFORMED),
        ([0], [1, 2], "q", FaultCode.STATEMENT_MALFORMED),
        ([0], [1], "", FaultCode.STATEMENT_MALFORMED),
        ([0], [1], "q1", FaultCode.STATEMENT_MALFORMED),
        ([0, 5], [1, 4], "q", FaultCode.OUT_OF_RANGE),
    ],
)
def test_what_is_no_box_is_refused(lows, highs, name, code):
    with pytest.raises(ScopeError) as caught:
        box(name, Unit.COUNT, lows, highs)
    assert caught.value.code is code

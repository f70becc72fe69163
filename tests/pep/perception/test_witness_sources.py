"""Independent sources of one fact: fingers and eyes, controller and model. What disagrees is not believed by CII-4."""

import pytest
from capabilities.statements.observation import Box, Capsule, Sphere
from pep.perception.consistency import (
    FINGERS_UM,
    POSE_UM,
    SURFACE_UM,
    WIDTH_UM,
    grip_contradicted,
    pose_contradicted,
    witnessed,
)
from pep.perception.sensor_frames import Look
from policies.evidence.evidence import SensorReading
from policies.primitives.cognition import BELIEVED

BALL = Sphere((0, 0, 0), 30_000)
ROD = Capsule((0, 0, 0), (0, 0, 100_000), 10_000)
BLOCK = Box((0, 0, 0), (20_000, 30_000, 60_000), (1_000_000, 0, 0, 0))
DIAGONAL_UM = 140_000


def test_the_tolerance_is_two_surfaces_and_a_step():
    assert WIDTH_UM == 2 * SURFACE_UM + FINGERS_UM
    assert round(85_000 / 228) == FINGERS_UM


@pytest.mark.parametrize(
    ("shape", "least_um", "most_um"),
    [(BALL, 60_000, 60_000), (ROD, 20_000, 120_000), (BLOCK, 40_000, DIAGONAL_UM)],
    ids=["ball", "rod", "block"],
)
def test_what_is_gripped_has_a_width_that_the_seen_thing_can_have(shape, least_um, most_um):
    for width_um, agrees in (
        (least_um - WIDTH_UM - 1, False),
        (least_um - WIDTH_UM, True),
        (least_um, True),
        (most_um, True),
        (most_um + WIDTH_UM, True),
        (most_um + WIDTH_UM + 1, False),
    ):
        assert (grip_contradicted(width_um, shape, on_something=True) == "") is agrees, width_um


def test_open_fingers_contradict_nothing_that_fits_between_them():
    assert grip_contradicted(85_000, BALL, on_something=False) == ""
    assert grip_contradicted(60_000 - WIDTH_UM - 1, BALL, on_something=False)
    assert grip_contradicted(0, BALL, on_something=False)


def test_the_tool_is_where_the_joints_put_it():
    here = (300_000, -200_000, 400_000)
    assert pose_contradicted(here, here) == ""
    assert pose_contradicted((300_000, -200_000, 400_000 + POSE_UM), here) == ""
    assert pose_contradicted((300_000, -200_000, 400_000 + POSE_UM + 1), here)
    assert pose_contradicted((303_000, -203_000, 403_000), here)  # 5.2 mm apart, no axis more than 3


@pytest.mark.parametrize("lost", [float("nan"), float("inf")])
def test_a_number_that_is_none_agrees_with_nothing(lost):
    assert pose_contradicted((lost, 0, 0), (0, 0, 0))
    assert grip_contradicted(lost, BALL, on_something=True)


def test_what_a_comparison_is_to_the_policy():
    assert witnessed("gripper", "", age_ms=40) == SensorReading("gripper", "fresh", "", 40)
    assert witnessed("gripper", "too wide", age_ms=40) == SensorReading("gripper", "invalid", "CONTRADICTED", 40)
    assert witnessed("gripper", "too wide", age_ms=40).state not in BELIEVED
    # One source alone is no agreement.
    assert witnessed("gripper", None, age_ms=40) == SensorReading("gripper", "missing", "", None)
    assert witnessed("gripper", "", age_ms=None) == SensorReading("gripper", "missing", "", None)


def test_a_look_carries_its_witnesses():
    odd = witnessed("arm", "the tool is elsewhere", age_ms=2)
    assert Look((), 0).reading(now_ms=0, limit_ms=500, witnesses=(odd,)).sensors == (odd,)
    assert Look((), 0).reading(now_ms=0, limit_ms=500).sensors == ()

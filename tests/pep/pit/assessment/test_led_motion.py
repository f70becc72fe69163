"""Motions that a force or a hand leads: their bounds, their envelope, and what they add to the index."""

from dataclasses import replace

import numpy as np
import pytest
from capabilities.values.scope import Tier
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.pit.assessment.assess import assess
from pep.pit.base.errors import UnprovenError
from pep.pit.robot.inverse_kinematics import stance
from pep.pit.search.stream_course import servo_drive
from pep.rtde.robot.state_receiver import JointState
from pep.pit.assessment.led_motion import (
    AGAIN_S,
    HAND_MILLI,
    MARGIN,
    TOUCHING_MILLI,
    WEAKEST_N,
    JointRates,
    LedArm,
    LedTool,
    LedView,
    fastest_of,
    led_age,
    led_cell,
    with_force,
)
from policies.evidence.evidence import Contribution
from tests.pep.kit import reading
from tests.pep.pit.scenes import ROBOT, with_person
from tests.pep.rtde.robot_cell import CELL

from pep.pit import Box, Contact, Scene, Thing

HOME = (-0.6, -1.62, 1.25, -1.2, -1.57, 0.0)
BASE = (0.0,) * 6
DOWN = LedTool(BASE, (0.0, 0.0, 0.01, 0.0, 0.0, 0.0), 0.05)
SEVERAL = LedTool(BASE, (0.004, 0.004, 0.004, 0.0, 0.0, 0.0), 0.05)
HAND = LedArm(0.15, 0.2, 0.3)
SEED = b"x" * 32
pytestmark = pytest.mark.clause("LSD-20")  # PHY-61 to PHY-63


def at(qd=BASE, q=HOME):
    return JointState(tuple(q), tuple(qd), 7, 1)


def begun(q=HOME):
    return stance(ROBOT, np.array(q)).position


def speeds_for(twist, q=HOME):
    return np.linalg.solve(stance(ROBOT, np.array(q)).jacobian, np.array(twist, dtype=float))


# ------------------------------------------------------------------------------------------------------------- bounds


@pytest.mark.parametrize("share", [-1.0, -0.4, 0.0, 0.7, 1.0])
def test_an_arm_that_goes_along_its_axis_as_fast_as_it_may_is_let_go_on(share):
    rates = JointRates.of(DOWN, ROBOT, HOME)
    assert rates.exceeded(at(speeds_for((0, 0, 0.01 * share, 0, 0, 0))), begun(), stop_s=0.06) == ""


@pytest.mark.parametrize(
    ("twist", "what"),
    [
        ((0, 0, 0.0125, 0, 0, 0), "joint speed"),
        ((0.01, 0, 0, 0, 0, 0), "joint speed"),
        ((0, 0, 0, 0, 0, 0.1), "joint speed"),
    ],
)
def test_what_is_faster_or_beside_its_axis_is_not(twist, what):
    rates = JointRates.of(DOWN, ROBOT, HOME)
    assert rates.exceeded(at(speeds_for(twist)), begun(), stop_s=0.06) == what


def test_a_number_that_is_none_is_above_every_bound():
    for led in (DOWN, SEVERAL, HAND):
        rates = JointRates.of(led, ROBOT, HOME)
        assert rates.exceeded(at((float("nan"), *BASE[1:])), begun(), stop_s=0.06) == "joint speed"


def test_a_hand_has_bounds_of_joints_and_tool():
    rates = JointRates.of(HAND, ROBOT, HOME)
    assert rates.exceeded(at((0.19, 0.0, 0.0, 0.0, 0.0, -0.2)), begun(), stop_s=0.06) == ""
    assert rates.exceeded(at((0.0, 0.0, 0.0, 0.0, 0.0, -0.21)), begun(), stop_s=0.06) == "joint speed"
    assert (
        JointRates.of(replace(HAND, tool_speed_m_s=0.04), ROBOT, HOME).exceeded(
            at((0.19, 0.0, 0.0, 0.0, 0.0, 0.0)), begun(), stop_s=0.06
        )
        == "tool speed"
    )


def test_the_tool_stays_within_its_distance_stop_included():
    rates = JointRates.of(DOWN, ROBOT, HOME)
    there = np.array(HOME) + speeds_for((0, 0, -0.0495, 0, 0, 0))
    assert rates.exceeded(at(q=there), begun(), stop_s=0.06) == ""
    assert rates.exceeded(at(speeds_for((0, 0, -0.01, 0, 0, 0)), there), begun(), stop_s=0.06) == "distance"


def test_what_would_turn_a_joint_faster_than_any_stop_is_made_for_is_unproven():
    for led in (replace(DOWN, speeds=(0, 0, 0.2, 0, 0, 0)), replace(DOWN, speeds=(0, 0, 0, 1.0, 0, 0))):
        with pytest.raises(UnprovenError):
            JointRates.of(led, ROBOT, HOME)
    stretched = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(UnprovenError):
        JointRates.of(DOWN, ROBOT, stretched)


# ----------------------------------------------------------------------------------------------------------- envelope


@pytest.mark.parametrize("led", [DOWN, SEVERAL, HAND], ids=["one axis", "several", "hand"])
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_wherever_the_bounds_let_an_arm_go_until_it_stands_is_in_its_envelope(led, data):
    """Any course of speeds within the bounds and a quarter, until it is judged again, reacts, and brakes."""
    cell = led_cell(CELL, led)
    rates = JointRates.of(led, ROBOT, HOME)
    motion = rates.envelope(cell)
    reaction_s = cell.watch_age_limit_s + cell.reaction_s
    course = servo_drive(ROBOT, motion, cell, reaction_s=reaction_s).course
    for_s = reaction_s + AGAIN_S + cell.stop_delay_s
    steps = 12
    shares = data.draw(st.lists(st.floats(-1, 1), min_size=steps, max_size=steps))
    besides = data.draw(st.lists(st.lists(st.floats(-1, 1), min_size=6, max_size=6), min_size=steps, max_size=steps))
    q, low, high = np.array(HOME), *course_box(course)
    for share, beside in zip(shares, besides, strict=True):
        qd = MARGIN * (share * rates.along + np.array(beside) * rates.beside)
        q = q + qd * for_s / steps
        braked = q + qd * np.abs(qd).max() / (2 * cell.stop_deceleration_rad_s2)
        for place in (q, braked):
            assert (low - 1e-9 <= place).all()
            assert (place <= high + 1e-9).all()


@pytest.mark.parametrize("led", [DOWN, SEVERAL, HAND], ids=["one axis", "several", "hand"])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_arm_that_goes_one_way_as_fast_as_it_may_ends_inside_too(led, way):
    cell = led_cell(CELL, led)
    rates = JointRates.of(led, ROBOT, HOME)
    reaction_s = cell.watch_age_limit_s + cell.reaction_s
    low, high = course_box(servo_drive(ROBOT, rates.envelope(cell), cell, reaction_s=reaction_s).course)
    qd = way * MARGIN * (rates.along + rates.beside)
    stands = np.array(HOME) + qd * (reaction_s + AGAIN_S + cell.stop_delay_s)
    stands += qd * np.abs(qd).max() / (2 * cell.stop_deceleration_rad_s2)
    assert (low - 1e-9 <= stands).all()
    assert (stands <= high + 1e-9).all()


def course_box(course):
    """Lowest and highest angle of each joint on a servo target's course, stray included."""
    stray = course.cells.stray.max(axis=0)
    ends = np.array([course.q(0.0), course.q(1.0)])
    return ends.min(axis=0) - stray, ends.max(axis=0) + stray


# -------------------------------------------------------------------------------------------------------------- index


def seen(led, scene, *, force_n=10.0, touch=frozenset(), cell=CELL, age_s=0.05):
    view = LedView(scene, age_s, cell, touch)
    return view.reading(led, ROBOT, HOME, force_n=force_n, seed=SEED)


def test_a_force_in_an_empty_cell_is_consequential():
    found = seen(DOWN, Scene())
    assert (found.index_milli, found.tier, found.violations) == (TOUCHING_MILLI, Tier.CONSEQUENTIAL, ())
    assert [each.kind for each in found.contributions] == ["by_force"]
    assert 10_000 <= found.tcp_speed_um_s <= 20_000
    assert found.start_urad == tuple(round(1e6 * q) for q in HOME)


@pytest.mark.parametrize(
    ("force_n", "milli"), [(0.0, TOUCHING_MILLI + 500), (WEAKEST_N, 3_000), (3 * WEAKEST_N, 4_000)]
)
def test_a_force_beside_a_person_counts_by_what_the_weakest_region_bears(force_n, milli):
    rates = JointRates.of(DOWN, ROBOT, HOME)
    near = replace(reading(3, 2_500), contributions=(Contribution("person", 2_500, "wrist_3", "p", 0, 0, 0, "camera"),))
    assert with_force(near, DOWN, rates, force_n=force_n).index_milli == milli
    far = replace(near, index_milli=1_900, contributions=(replace(near.contributions[0], index_milli=1_900),))
    assert with_force(far, DOWN, rates, force_n=3 * WEAKEST_N).index_milli == TOUCHING_MILLI


def touching(led, *, touch=frozenset({"bench"}), above_m=0.012):
    """A bench under the tool point, which the cell lets the tool touch."""
    x, y, z = begun()
    bench = Thing("bench", "rigid", Box((x, y, z - above_m - 0.05), (0.1, 0.1, 0.05)), 0.0)
    cell = replace(CELL, contacts=(Contact("bench", "tool"),))
    return seen(led, Scene(objects=(bench,)), touch=touch, cell=cell)


@pytest.mark.parametrize(
    "led", [replace(DOWN, speeds=(0, 0, 0.025, 0, 0, 0)), replace(SEVERAL, speeds=(0.006,) * 3 + (0.0,) * 3)]
)
def test_what_may_be_touched_is_pressed_on_at_a_gentle_speed_and_nothing_else_is(led):
    assert touching(led).index_milli == TOUCHING_MILLI
    assert touching(led).violations == ()
    assert touching(led, touch=frozenset()).index_milli > TOUCHING_MILLI


def test_no_fast_contact_is_meant():
    assert touching(replace(DOWN, speeds=(0, 0, 0.04, 0, 0, 0))).index_milli > TOUCHING_MILLI


def test_a_tool_that_turns_is_above_its_bound():
    rates = JointRates.of(replace(SEVERAL, speeds=(0.006,) * 3 + (0.0,) * 3), ROBOT, HOME)
    assert rates.exceeded(at(speeds_for((0, 0, 0, 0, 0, 0.015))), begun(), stop_s=0.06) == ""
    assert rates.exceeded(at(speeds_for((0, 0, 0, 0, 0, 0.025))), begun(), stop_s=0.06) == "tool turning"


def test_a_person_beside_a_force_raises_it_and_a_hand_is_a_persons():
    scene = with_person(0.5)
    assert seen(DOWN, scene).index_milli > TOUCHING_MILLI


def test_who_leads_the_arm_by_hand_does_not_count_and_all_else_does():
    empty = seen(HAND, Scene())
    scene = with_person(0.35)
    assert seen(HAND, scene).index_milli == empty.index_milli == HAND_MILLI
    assert empty.tcp_speed_um_s <= 200_000
    fast = seen(replace(HAND, joint_speed_rad_s=0.7), Scene())
    assert "self" in fast.violations or fast.tier > Tier.HIGH_CONSEQUENCE


def test_what_may_not_be_is_told_with_the_speed_that_may():
    led = replace(HAND, joint_speed_rad_s=0.7)
    found = seen(led, Scene())
    told = found.lower_tier_speed
    assert 0 < told < fastest_of(led) == 700_000
    instead = seen(replace(led, joint_speed_rad_s=told / 1e6), Scene())
    assert instead.tier is Tier.HIGH_CONSEQUENCE
    assert not instead.violations
    assert fastest_of(DOWN) == 10_000


def test_a_hand_needs_no_reaction_to_a_view_that_is_fresh():
    assert led_age(0.3, CELL, HAND) == 0.0
    assert led_age(CELL.perception_age_limit_s + 0.1, CELL, HAND) > CELL.perception_age_limit_s
    assert led_age(None, CELL, HAND) is None
    assert led_age(0.3, CELL, DOWN) == 0.3
    assert led_cell(CELL, None) is CELL


def test_the_engines_agree_on_it():
    """The envelope is one of a servo target, of which the second engine and the checker know already."""
    motion = JointRates.of(DOWN, ROBOT, HOME).envelope(CELL)
    found = assess(ROBOT, Scene(), motion, CELL, perception_age_s=0.05, touch=frozenset(), seed=SEED)
    assert found.index == 1.0

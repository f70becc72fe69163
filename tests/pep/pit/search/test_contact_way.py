"""Way of a tool until a contact, assessed as if nothing stopped it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pep.base.stop_model import patience_s
from pep.pit.base.errors import MotionError
from pep.pit.scene.cell import Contact
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.contact_way import BACK_M_S2, BACK_S, STOPL_M_S2, contact_speed, until_contact
from pep.pit.search.engine import chosen
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.lines import marched, placed
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty

from pep.pit import Box, MoveJ, Scene, Thing, assess


SLOW = 0.02
PATIENCE = patience_s(CELL.stop_deceleration_rad_s2)
MEANT = replace(CELL, time_limit_s=60.0, contacts=(Contact("block", "tool"),))
TOUCH = frozenset({"block"})


def at_height(top_m):
    x, y, _ = placed(HOME)[0]
    return Scene(objects=(Thing("block", "rigid", Box((x, y, top_m - 0.02), (0.05, 0.05, 0.02)), 0.0),))


def block(gap_m):
    """A block whose top is so far below the lowest part of the tool at home."""
    top = placed(HOME)[0][2] - 0.15
    scene = at_height(top)
    pairs = pairs_of(ROBOT, scene, MEANT, grown_m=0.0, touch=TOUCH)
    path = chosen().path(ROBOT, MoveJ(HOME, HOME, 1.0, 1.0))
    gap = float(path.clearance_at(pairs, 0, np.flatnonzero(pairs.touchable)).min())
    return at_height(top + gap - gap_m)


def planned(scene, *, speed=SLOW, distance=0.1, touch=TOUCH, cell=MEANT):
    twist = (0.0, 0.0, -speed, 0.0, 0.0, 0.0)
    motion = contact_speed(HOME, twist, 0.25, distance)
    return until_contact(ROBOT, motion, scene, cell, touch=touch, speed_m_s=speed, patience_s=PATIENCE)


def way_m(motion):
    """Of the whole answer, its stop included."""
    return math.hypot(*motion.twist[:3]) * (motion.duration_s + CELL.stop_delay_s + 0.02)


def test_without_anything_to_touch_it_is_as_long_as_granted():
    motion, held_s = planned(empty(), distance=0.05)
    assert way_m(motion) == pytest.approx(0.05, abs=1e-6)
    assert SLOW * (held_s + PATIENCE + CELL.stop_delay_s) <= 0.05


def test_it_ends_inside_of_what_may_be_touched():
    free, _ = planned(empty())
    motion, held_s = planned(block(0.03))
    assert way_m(motion) < way_m(free)
    assert 0.03 < SLOW * held_s + 0.02
    answer = assess(ROBOT, block(0.03), motion, MEANT, perception_age_s=0.1, touch=TOUCH, seed=SEED)
    assert not isinstance(answer, ImpactFault)
    assert not answer.violations
    assert answer.index <= 2.0 + 1e-9


def test_what_may_not_be_touched_is_gone_into_and_so_refused():
    motion, _ = planned(block(0.03), touch=NOTHING)
    answer = assess(ROBOT, block(0.03), motion, MEANT, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert answer.index > 2.0


def test_the_way_back_to_the_contact_is_no_faster():
    for speed in (0.005, 0.02, 0.1, 0.25):
        motion = contact_speed(HOME, (speed, 0.0, 0.0, 0.0, 0.0, 0.0), 0.25, 0.1)
        fastest = math.hypot(*motion.twist[:3])
        braked = speed * speed / (2 * STOPL_M_S2) + speed * BACK_S
        assert fastest >= speed
        assert fastest >= min(0.25, math.sqrt(BACK_M_S2 * braked)) - 1e-12


@pytest.mark.parametrize("twist", [(0.0,) * 6, (0.0, 0.0, -0.02, 0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.1, 0.0)])
def test_a_tool_that_turns_or_stands_is_refused(twist):
    with pytest.raises(MotionError) as refused:
        contact_speed(HOME, twist, 0.25, 0.1)
    assert refused.value.reason == "OUT_OF_RANGE"


def test_too_fast_for_how_near_it_is_is_refused():
    with pytest.raises(MotionError) as refused:
        planned(block(0.005), speed=0.25)
    assert refused.value.reason == "OUT_OF_RANGE"


@pytest.mark.parametrize("speed", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("gap_m", [0.02, 0.04])
def test_an_arm_that_detects_nothing_is_stopped_where_it_was_assessed(speed, gap_m):
    """Marched with pinocchio at the commanded speed until the last instant that its time allows."""
    motion, held_s = planned(block(gap_m), speed=speed)
    late = held_s + PATIENCE + CELL.stop_delay_s
    track = marched(HOME, np.array([0.0, 0.0, -speed * late]), np.zeros(3), np.linspace(0, 1, 20))
    lowest = placed(track[-1][0])[0][2]
    assert placed(HOME)[0][2] - lowest <= way_m(motion)

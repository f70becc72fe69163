"""Paper's three cells as fixed points: C0 tier 1, C1 tier 2, C2 tier 3, at the speeds people use."""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.scene.separation import stopping
from tests.pep.pit.scenes import CELL, FRONT, NOTHING, ROBOT, SEED, empty, sweep, tcp, with_glass, with_person

from pep.pit import Capsule, Person, Region, adult_at_distance, assess, standing_adult

pytestmark = pytest.mark.version

FRESH = 0.10  # age of the view, s
# An arm with nominal kinematics: 7.5 mm of uncertainty. With 5 mm every index was at most 0.03 lower, every tier the same.
SCENES = {"C0": empty(), "C1": with_glass(), "C2": with_person(), "C2 behind": with_person(bearing=FRONT + np.pi)}
TABLE = {  # speed: (acceleration, {cell: (tier, index)}); the stop model of 8 rad/s2
    0.25: (0.8, {"C0": (1, 1.00), "C1": (2, 1.84), "C2": (3, 2.92), "C2 behind": (3, 2.40)}),
    0.5: (1.0, {"C0": (1, 1.00), "C1": (2, 1.88), "C2": (3, 2.97), "C2 behind": (3, 2.46)}),
    1.05: (1.4, {"C0": (1, 1.00), "C1": (2, 2.00), "C2": (3, 3.00), "C2 behind": (3, 2.56)}),
    2.0: (3.0, {"C0": (1, 1.00), "C1": (3, 2.61), "C2": (3, 3.00), "C2 behind": (3, 2.69)}),
    # A sweep this fast stops late: it counts near the table, and near the head of the person in front.
    3.0: (5.0, {"C0": (3, 2.14), "C1": (3, 2.74), "C2": (4, 3.99), "C2 behind": (3, 2.78)}),
}
ROWS = [(cell, v, a, tier, index) for v, (a, row) in TABLE.items() for cell, (tier, index) in row.items()]


@pytest.mark.parametrize(("cell", "speed", "acceleration", "tier", "index"), ROWS)
def test_cells_keep_their_tiers(cell, speed, acceleration, tier, index):
    answer = assess(
        ROBOT, SCENES[cell], sweep(speed, acceleration), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED
    )
    assert (answer.tier, answer.violations, answer.perception) == (tier, (), "fresh")
    assert answer.index == pytest.approx(index, abs=0.02)


# Index by the distance (m) of a body's axis, of radius 0.19 m, in front; at 0.1, 0.5, 1.05, 2 and 3 rad/s.
DISTANCES = {
    0.60: (3.00, 3.00, 3.00, 3.00, 3.00),
    0.69: (2.89, 2.97, 3.00, 3.00, 3.00),
    0.80: (2.69, 2.80, 2.93, 3.00, 3.00),
    1.00: (2.32, 2.48, 2.66, 2.87, 2.99),
    1.10: (2.14, 2.32, 2.52, 2.76, 2.90),
    1.20: (1.93, 2.16, 2.39, 2.65, 2.80),
    1.30: (1.60, 2.01, 2.25, 2.54, 2.70),
    1.40: (1.26, 1.68, 2.12, 2.43, 2.60),
    1.50: (1.00, 1.35, 1.96, 2.32, 2.50),
    1.60: (1.00, 1.01, 1.63, 2.21, 2.41),
    1.80: (1.00, 1.00, 1.00, 1.98, 2.21),
    2.00: (1.00, 1.00, 1.00, 1.31, 2.14),
}
RAMPS = {0.1: 0.8, 0.5: 1.0, 1.05: 1.4, 2.0: 3.0, 3.0: 5.0}  # rad/s2 at these speeds


def with_axis(distance):
    """A trunk whose axis stands so far in front, and a hand in it: of a tracked person."""
    x, y = distance * np.cos(FRONT), distance * np.sin(FRONT)
    body = (
        (Region.TORSO, Capsule((x, y, 0.0), (x, y, 0.9), 0.19)),
        (Region.HAND, Capsule((x, y, 0.3), (x, y, 0.4), 0.05)),
    )
    return replace(empty(), people=(Person("p", body),))


@pytest.mark.parametrize("distance", DISTANCES)
def test_index_by_distance_and_speed(distance):
    row = [
        assess(ROBOT, with_axis(distance), sweep(v, a), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED).index
        for v, a in RAMPS.items()
    ]
    assert row == pytest.approx(DISTANCES[distance], abs=0.02)


def test_index_by_age_of_the_view():
    """At 1.3 m, default speed: nothing younger than the watch's 0.15 s counts as younger."""
    for age, index in {0.02: 2.25, 0.1: 2.25, 0.15: 2.25, 0.3: 2.50, 0.5: 2.68, 1.0: 3.00}.items():
        answer = assess(ROBOT, with_axis(1.3), sweep(), CELL, perception_age_s=age, touch=NOTHING, seed=SEED)
        assert answer.index == pytest.approx(index, abs=0.02)


def test_protective_distance_by_speed():
    """S_p of a tracked person by hand, with v = 0.7 w and T_r = 0.21 s.

    It is 1.6 (T_r + T_s) + v (T_r + 0.06 + w / 16) + 0.1.
    """
    for omega, distance in {0.1: 0.571, 0.5: 0.737, 1.05: 0.989, 2.0: 1.485, 3.0: 2.093}.items():
        stop = stopping(CELL, perception_age_s=FRESH, joint_speed_rad_s=omega)
        assert stop.approach_m(0.1) + stop.travel_m(0.7 * omega) == pytest.approx(distance, abs=1e-3)
        by_hand = 1.6 * (0.21 + 0.06 + omega / 8) + 0.7 * omega * (0.21 + 0.06 + omega / 16) + 0.1
        assert by_hand == pytest.approx(distance, abs=1e-3)


def test_what_would_be_allowed_is_named_and_true():
    """A denial names the highest speed of a lower tier; that speed has it, and a little more has not."""
    answer = assess(ROBOT, with_glass(), sweep(2.0, 3.0), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED)
    lower = answer.lower_tier_speed
    assert answer.tier == 3
    assert 1.0 < lower < 1.15
    for speed, tier in ((lower, 2), (lower * 1.02, 3)):
        again = assess(ROBOT, with_glass(), sweep(speed, 3.0), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED)
        assert again.tier == tier


def test_near_a_person_no_speed_lowers_the_tier():
    answer = assess(ROBOT, with_person(), sweep(0.5, 1.0), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED)
    assert answer.tier == 3
    assert answer.lower_tier_speed is None
    assert answer.reading().lower_tier_speed is None


def test_half_a_metre_is_from_the_base_axis_to_the_nearest_surface():
    for bearing in (0.0, 1.0, FRONT):
        person = adult_at_distance(0.5, bearing_rad=bearing)
        near = []
        for _, shape in person.regions:
            ends = np.array(
                [
                    getattr(shape, "a_m", getattr(shape, "center_m", None)),
                    getattr(shape, "b_m", getattr(shape, "center_m", None)),
                ]
            )
            near.append(np.linalg.norm(ends[:, :2], axis=1).min() - shape.radius_m)
        assert min(near) == pytest.approx(0.5)


def test_farther_people_count_less():
    indices = []
    for distance in (0.5, 0.7, 0.9, 1.1, 1.3, 1.6, 2.0):
        answer = assess(ROBOT, with_person(distance), sweep(), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED)
        indices.append(answer.index)
    assert all(a >= b - 0.01 for a, b in zip(indices, indices[1:], strict=False))
    assert indices[0] == pytest.approx(3, abs=0.01)
    assert indices[-1] == 1


def test_a_path_through_a_person_is_a_violation():
    x, y, _ = tcp()
    scene = replace(empty(), people=(standing_adult(x * 1.2, y * 1.2),))
    for speed in (0.1, 1.05):
        answer = assess(ROBOT, scene, sweep(speed, 1.0), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED)
        assert answer.violations == ("person",)
        assert answer.tier == 4
        assert answer.lower_tier_speed is None


def test_the_reading_is_the_assessment_in_integers():
    answer = assess(ROBOT, with_glass(), sweep(2.0, 3.0), CELL, perception_age_s=FRESH, touch=NOTHING, seed=SEED)
    reading = answer.reading()
    assert reading.tier == answer.tier
    assert reading.index_milli == -int(-answer.index * 1000 // 1)
    assert reading.contributions[0].kind == "fragile"
    assert reading.contributions[0].object == "glass"
    assert reading.contributions[0].link == "gripper_high"
    assert reading.contributions[0].index_milli >= max((c.index_milli for c in reading.contributions[1:]), default=0)
    assert 0 < reading.contributions[0].clearance_um < 100_000
    assert reading.lower_tier_speed == int(answer.lower_tier_speed * 1e6)
    assert reading.perception_age_ms == 100
    assert (reading.model_digest, reading.scene_digest) == (ROBOT.model_digest, with_glass().digest)

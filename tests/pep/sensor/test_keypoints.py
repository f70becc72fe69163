"""People by keypoints: each region where it belongs, and everything that a hidden part could be inside what is assumed."""

import math
import random

import pytest
from capabilities.statements.observation import Sphere
from pep.pit import Robot
from pep.pit.scene.contact_limits import LIMITS, contact_speed_m_s
from pep.pit.scene.scene import LIMBS, REGION_NAMES, Region
from pep.sensor.keypoints import BODY_25, COCO_17, HEAD_M, STEP_M, TORSO_R

from pep.sensor import Camera, SensorError, body_25, coco_17, person_at

FLOOR = -0.8
STANDING = {
    "nose": (0.88, 0.0, 0.80), "left_eye": (0.90, 0.03, 0.83), "right_eye": (0.90, -0.03, 0.83),
    "left_ear": (0.98, 0.08, 0.80), "right_ear": (0.98, -0.08, 0.80),
    "left_shoulder": (1.0, 0.2, 0.6), "right_shoulder": (1.0, -0.2, 0.6), "neck": (1.0, 0.0, 0.6),
    "left_elbow": (1.0, 0.25, 0.3), "right_elbow": (1.0, -0.25, 0.3),
    "left_wrist": (0.8, 0.25, 0.2), "right_wrist": (0.8, -0.25, 0.2),
    "left_hip": (1.0, 0.1, 0.1), "right_hip": (1.0, -0.1, 0.1), "mid_hip": (1.0, 0.0, 0.1),
    "left_knee": (1.0, 0.1, -0.3), "right_knee": (1.0, -0.1, -0.3),
    "left_ankle": (1.0, 0.1, -0.72), "right_ankle": (1.0, -0.1, -0.72),
}  # fmt: skip
"""An adult who faces the robot, by the middles of their joints, in the base frame."""


def points(names, *hidden, **changed):
    joints = {**STANDING, **changed}
    return [None if name in hidden else joints.get(name) for name in names]


def seen(*hidden, **changed):
    return coco_17(points(COCO_17, *hidden, **changed), floor_z_m=FLOOR)


def depth_in(sight, point):
    """Depth of a point in the deepest of a person's regions, metres; below 0 it is outside all."""

    def depth(shape):
        if isinstance(shape, Sphere):
            return shape.radius_um / 1e6 - math.dist(point, [each / 1e6 for each in shape.center_um])
        a, b = ([each / 1e6 for each in end] for end in (shape.a_um, shape.b_um))
        along = [q - p for p, q in zip(a, b, strict=True)]
        share = sum(d * (p - q) for d, p, q in zip(along, point, a, strict=True)) / sum(d * d for d in along)
        share = min(1.0, max(0.0, share))
        return shape.radius_um / 1e6 - math.dist(point, [p + share * d for p, d in zip(a, along, strict=True)])

    return max(depth(shape) for _, shape in sight.regions)


def regions_of(sight):
    return {region for region, _ in sight.regions}


def test_a_whole_person_has_every_region_and_nothing_assumed():
    whole = seen()
    assert regions_of(whole) == REGION_NAMES and whole.unseen == ()
    for joint, place in STANDING.items():
        assert depth_in(whole, place) > 0.1, joint
    upper_arms = [shape for region, shape in whole.regions if region == "upper_arm"]
    assert {(arm.a_um, arm.b_um, arm.radius_um) for arm in upper_arms} == {
        ((1_000_000, y * 200_000, 600_000), (1_000_000, y * 250_000, 300_000), 180_000) for y in (1, -1)
    }


def test_body_25_is_the_same_person():
    other = body_25(points(BODY_25), floor_z_m=FLOOR)
    assert {region: shape for region, shape in other.regions} == {region: shape for region, shape in seen().regions}


def test_the_head_is_inside_the_ball_about_the_face():
    head = next(shape for region, shape in seen().regions if region == "head")
    faces = [STANDING[name] for name in COCO_17[:5]]
    assert [each / 1e6 for each in head.center_um] == pytest.approx([sum(axis) / 5 for axis in zip(*faces)], abs=1e-6)
    assert head.radius_um == round((HEAD_M + 0.10) * 1e6)


def test_points_of_a_depth_image_are_put_behind_the_surface_that_was_seen():
    # a camera at the base, 0.6 m up, that looks along x: its z is x, its x is -y, its y is -z
    camera = Camera((0.0, 0.0, 0.6), ((0, 0, 1), (-1, 0, 0), (0, -1, 0)))
    given = [(-y, 0.6 - z, x) for x, y, z in points(COCO_17)]
    middles = coco_17(given, camera=camera, on_surface=False, floor_z_m=FLOOR)
    assert {region: shape for region, shape in middles.regions} == {region: shape for region, shape in seen().regions}
    behind = coco_17(given, camera=camera, floor_z_m=FLOOR)
    torso = next(shape for region, shape in behind.regions if region == "torso")
    # each shoulder is hypot(1, 0.2) away and goes 0.12 m further; their middle goes 0.12 / hypot(1, 0.2) of 1 m
    assert torso.a_um == pytest.approx((round((1 + 0.12 / math.hypot(1, 0.2)) * 1e6), 0, 600_000), abs=2)
    assert torso.radius_um == round((TORSO_R + 0.10) * 1e6)


# --- what is not seen ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hidden", ["left_wrist", "right_elbow", "left_shoulder"])
def test_one_hidden_part_of_an_arm_makes_physics_take_both_for_unseen(hidden):
    person = seen(hidden)
    assert LIMBS.isdisjoint(regions_of(person)), "one region of an arm would count as both arms tracked (PHY-3)"
    assert f"{hidden.partition('_')[0]}_arm" in person.unseen
    for joint in ("left_elbow", "right_elbow", "left_wrist", "right_wrist"):
        if joint != hidden:
            assert depth_in(person, STANDING[joint]) > 0 or hidden == joint.replace("wrist", "elbow")


def test_a_part_that_is_told_as_another_has_the_stricter_limits():
    assert Robot.load("ur3e", tool="robotiq_2f85").moving_mass_kg / 2 > 2
    for mass_kg in (2, 5.9, 12, 40):  # half the arm and all of its tool
        for area_m2 in (1e-5, 1e-4, 1e-3):
            limits = {region: contact_speed_m_s(region, mass_kg=mass_kg, area_m2=area_m2) for region in Region}
            assert limits[Region.TORSO] <= min(limits[region] for region in LIMBS)
            assert limits[Region.HEAD] == min(limits.values()) and LIMITS[Region.HEAD].sensitive
            assert limits[Region.SHIN] <= limits[Region.THIGH]


def test_a_head_that_is_not_seen_is_anywhere_about_the_shoulders():
    person = seen(*COCO_17[:5])
    assert person.unseen == ("head",)
    for lean in (0, 0.4, 0.8, -0.8):
        assert depth_in(person, (1.0 + 0.3 * math.sin(lean), 0.0, 0.6 + 0.3 * math.cos(lean))) > 0


def test_hidden_legs_are_below_the_hips_within_a_step():
    person = seen("left_knee", "right_knee", "left_ankle", "right_ankle")
    assert person.unseen == ("left_leg", "right_leg")
    for foot in ((1.0, 0.1), (1.0 - STEP_M, 0.1), (1.0 + STEP_M, -0.1)):
        assert depth_in(person, (*foot, FLOOR)) > 0
    assert depth_in(seen(), (1.0 - STEP_M, 0.1, FLOOR)) < 0


def test_behind_a_bench_the_body_goes_on_down_to_the_floor():
    person = seen(*(name for name in COCO_17 if name.partition("_")[2] in ("hip", "knee", "ankle")))
    assert "hips" in person.unseen
    for x, z in ((1.0, 0.1), (0.85, 0.0), (1.0, -0.3), (0.8, FLOOR)):
        assert depth_in(person, (x, 0.0, z)) > 0


def test_from_the_side_the_other_shoulder_is_inside():
    person = seen(*(name for name in COCO_17 if name.startswith("right")))
    for joint in ("right_shoulder", "right_hip"):
        assert depth_in(person, STANDING[joint]) > 0, joint


def test_a_hidden_knee_is_inside_at_every_bend():
    for turn in random.Random(7).sample(range(360), 40):
        bend, swing = math.radians(turn % 120), math.radians(turn)
        hip = STANDING["left_hip"]
        knee = (hip[0] + 0.43 * math.sin(bend) * math.cos(swing), hip[1] + 0.43 * math.sin(bend) * math.sin(swing),
                hip[2] - 0.43 * math.cos(bend))  # fmt: skip
        ankle = (knee[0], knee[1], knee[2] - 0.40)
        assert depth_in(seen("left_knee", left_ankle=ankle), knee) > 0


def test_a_keypoint_that_hit_the_wall_behind_counts_as_not_seen():
    person = seen(left_wrist=(4.0, 0.25, 0.2))
    assert person.unseen == ("left_arm",) and depth_in(person, (4.0, 0.25, 0.2)) < 0
    assert person.regions == seen("left_wrist").regions


def test_a_low_confidence_counts_as_not_seen():
    given = [(*place, 0.9) for place in points(COCO_17)]
    given[COCO_17.index("left_wrist")] = (0.0, 0.0, 0.0, 0.0)
    assert coco_17(given, floor_z_m=FLOOR).regions == seen("left_wrist").regions


def test_somebody_of_whom_only_the_place_is_known_is_a_pillar():
    ((region, shape),) = person_at(0.7, -0.1, floor_z_m=FLOOR).regions
    assert (region, shape.a_um, shape.b_um) == ("head", (700_000, -100_000, -800_000), (700_000, -100_000, 1_200_000))


# --- what is refused -------------------------------------------------------------------------------------------------


def spoilt(name, place):
    given = points(COCO_17)
    given[COCO_17.index(name)] = place
    return given


@pytest.mark.parametrize(
    ("given", "code"),
    [
        (spoilt("nose", (0.0, 0.0, 0.0)), "NO_DEPTH"),
        ([(0.0, 0.0, 0.0)] * 17, "NO_DEPTH"),
        (spoilt("nose", (math.nan, 0.0, 1.0)), "NOT_FINITE"),
        (spoilt("nose", (1.0, 0.0, math.inf)), "NOT_FINITE"),
        ([tuple(1000 * each for each in place) for place in points(COCO_17)], "NOT_METRES"),
        ([tuple(each / 1000 for each in place) for place in points(COCO_17)], "NOT_METRES"),
        (points(COCO_17)[:16], "SIGHT_MALFORMED"),
        (spoilt("nose", (1.0, 0.0)), "SIGHT_MALFORMED"),
        (spoilt("nose", (1.0, 0.0, "1")), "SIGHT_MALFORMED"),
        (spoilt("nose", "abc"), "SIGHT_MALFORMED"),
        (spoilt("nose", (1.0, 0.0, 1.0, 1.5)), "SIGHT_MALFORMED"),
        ([None] * 17, "NO_BODY"),
        (points(COCO_17, "left_shoulder", "right_shoulder"), "NO_BODY"),
        ([(x, y, z - 2.0) for x, y, z in points(COCO_17)], "NO_BODY"),  # hips below the floor
        ([(2.0 * number, 0.0, 1.0) for number in range(1, 15)] + [None] * 3, "NO_BODY"),  # nobody's
    ],
)
def test_keypoints_of_nobody_are_refused(given, code):
    with pytest.raises(SensorError) as refused:
        coco_17(given, floor_z_m=FLOOR)
    assert refused.value.code == code and refused.value.step.endswith(".")

"""Paths with cut corners: against an arm that cuts them in its own ways, and under way."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.campaign.blends import STEP_S, judged, moved, trial
from tests.pep.pit.lines import placed, pose_of
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty

from pep.pit.assessment.course_remaining import HORIZON_S, RemainingCourse, RemainingLegs
from pep.pit.search.blended_course import blended_drives

from pep.pit import BlendedPath, JointLeg, JointPath, LineLeg, Scene, Sphere, Thing, assess, remaining

pytestmark = [pytest.mark.timeout(120)]

PATIENT = replace(CELL, time_limit_s=60.0, watch_time_limit_s=60.0)
TURN, LIFT = np.array([0.3, 0, 0, 0, 0, 0]), np.array([0, 0, 0.25, 0, 0, 0])


def at(*ways):
    return tuple((np.array(HOME) + sum(ways)).tolist())


def joints(blend_m, speed=0.8):
    """The base turns, then the elbow."""
    one = JointLeg(at(TURN), speed, 2.0, blend_m)
    return BlendedPath(HOME, (one, JointLeg(at(TURN, LIFT), speed, 2.0)))


def lines(blend_m):
    """Along and then up, the tool as it is."""
    x, y, z, *turn = pose_of(HOME)
    along, up = (x, y + 0.1, z - 0.02, *turn), (x, y + 0.1, z - 0.1, *turn)
    return BlendedPath(HOME, (LineLeg(along, 0.2, 1.0, blend_m), LineLeg(up, 0.2, 1.0)))


def mixed(blend_m):
    """A joint move, and a line from there."""
    x, y, z, *turn = pose_of(at(TURN))
    leg = JointLeg(at(TURN), 0.8, 2.0, blend_m)
    return BlendedPath(HOME, (leg, LineLeg((x, y, z - 0.08, *turn), 0.2, 1.0)))


def ask(path, scene=None, cell=PATIENT):
    scene = empty() if scene is None else scene
    return assess(ROBOT, scene, path, cell, perception_age_s=0.1, touch=NOTHING, seed=SEED)


@pytest.mark.parametrize("number", [1, 7])
def test_no_cut_corner_exceeds_the_answer(number):
    print(f"seed 1, trial {number}")
    word, detail = trial(1, number)
    assert word == "held", detail


def inside_of(path, blend_m):
    """A ball beside the middle of the chord, away from the waypoint."""
    q = moved(path, "chord")[1]
    middle = placed(q[len(q) // 2])[0]
    corner = placed(path.legs[0].target if isinstance(path.legs[0], JointLeg) else q[0])[0]
    away = middle - corner
    centre = middle + away / np.linalg.norm(away) * 0.13
    thing = Thing("ball", "fragile", Sphere(tuple(centre.tolist()), 0.02), 0.0)
    return Scene(objects=(thing,))


@pytest.mark.parametrize("made", [joints, lines, mixed])
@pytest.mark.parametrize("manner", ["through", "parabola", "chord", "tool"])
def test_what_stands_inside_of_a_corner_counts(made, manner):
    path = made(0.03)
    scene = inside_of(path, 0.03)
    answer = ask(path, scene)
    assert not isinstance(answer, ImpactFault)
    word, detail = judged(scene, path, answer, 0, partial(moved, path), (manner,))
    assert word == "held", detail


@pytest.mark.parametrize("made", [joints, lines, mixed])
def test_a_corner_that_is_cut_is_never_less_than_one_that_is_not(made):
    plain, cut = ask(made(0.0)), ask(made(0.03))
    assert cut.index >= plain.index - 0.011  # the search's own resolution
    assert cut.speed_m_s >= plain.speed_m_s


def test_without_blends_it_is_a_joint_path():
    path = joints(0.0)
    other = ask(JointPath(path.start, path.legs))
    assert ask(path).index == pytest.approx(other.index, abs=0.02)


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (joints(math.nan), "NOT_FINITE"),
        (joints(-0.01), "OUT_OF_RANGE"),
        (joints(0.5), "OUT_OF_RANGE"),  # more than half of a leg
        (replace(joints(0.0), legs=(replace(joints(0.0).legs[0], blend_m=0.01),)), "OUT_OF_RANGE"),  # at the end
        (replace(joints(0.0), legs=()), "PARAMETERS_WRONG"),
        (replace(joints(0.0), legs=joints(0.0).legs * 129), "PARAMETERS_WRONG"),
        (BlendedPath(HOME, (LineLeg((1.5, 0.0, 0.3, 0.0, 3.1, 0.0), 0.1, 0.5),)), "UNPROVEN"),
        (BlendedPath(HOME, (JointLeg(HOME, 0.5, 1.0, 0.01), *joints(0.0).legs)), "OUT_OF_RANGE"),  # beside no way
    ],
)
def test_what_is_no_such_path_is_refused(path, reason):
    found = ask(path)
    assert isinstance(found, ImpactFault)
    assert found.reason == reason


def test_beyond_a_joints_range_is_a_violation():
    path = BlendedPath(HOME, (JointLeg((7.0, *HOME[1:]), 0.5, 1.0), *joints(0.0).legs))
    assert "joint_limit" in ask(path).violations


# --------------------------------------------------------------------------------------------------------- under way


def rest(path, q, scene=None, authorised=4000):
    return remaining(
        ROBOT, empty() if scene is None else scene, path, PATIENT, at_rad=tuple(q), authorised_milli=authorised,
        perception_age_s=0.1, touch=NOTHING,
    )  # fmt: skip


@pytest.mark.parametrize("made", [joints, lines, mixed])
@pytest.mark.parametrize("manner", ["through", "parabola", "chord"])
def test_the_watch_knows_an_arm_that_cuts_a_corner(made, manner):
    path = made(0.03)
    authorised = math.ceil(ask(path).index * 1000)
    for part in moved(path, manner):
        for q in part[:: max(1, len(part) // 5)]:
            found = rest(path, q, authorised=authorised)
            assert found.holds, found


def seam(legs=8, radius_m=0.06, speed_m_s=0.1, blend_m=0.004):
    """Half a circle of short lines, each rounded into the next."""
    x, y, z, *turn = pose_of(HOME)
    angles = [math.pi * k / legs for k in range(1, legs + 1)]
    ends = [(x + radius_m * (1 - math.cos(a)), y - radius_m * math.sin(a), z, *turn) for a in angles]
    return BlendedPath(HOME, tuple(LineLeg(end, speed_m_s, 1.0, blend_m if end != ends[-1] else 0.0) for end in ends))


def courses(path):
    return [drive for _, drive in blended_drives(ROBOT, path, check_time=lambda: None)]


@pytest.mark.parametrize("manner", ["through", "parabola", "chord", "tool"])
@pytest.mark.parametrize("path", [joints(0.03), lines(0.03), mixed(0.03), seam(3)])
def test_no_arm_is_through_a_leg_or_a_corner_sooner_than_is_reckoned_with(path, manner):
    parts, each = moved(path, manner), courses(path)
    took_s = [(len(part) - 1) * STEP_S for part in parts]
    if manner == "through":  # its legs go from waypoint to waypoint
        assert sum(took_s) >= sum(one.least_s for one in each)
        return
    least_s = [sum(one.least_s for one in each[5 * (k // 2) + k % 2 :][: 4 if k % 2 else 1]) for k in range(len(parts))]
    assert len(each) == 5 * (len(parts) // 2) + 1
    for took, least in zip(took_s, least_s, strict=True):
        assert took >= least - STEP_S


def test_nearly_all_of_the_time_for_a_flat_corner_is_known():
    through_s = 2 * 0.004 / 0.1
    assert all(0.6 * through_s < one.least_s < through_s for one in courses(seam())[1::5])


def looked_at(path, q, horizon_s=HORIZON_S):
    """Number of the last course that a look at an arm there asks about."""
    asked = []

    def rests():
        for number, drive in enumerate(courses(path)):
            asked.append(number)
            start = tuple(drive.course.q(0.0).tolist())
            yield RemainingCourse(
                ROBOT, start, drive, PATIENT, at_rad=tuple(q), authorised_milli=4000, check_time=lambda: None
            )

    legs = RemainingLegs(rests(), lambda: None, horizon_s=horizon_s)
    assert legs.prepare(empty(), 0.1, NOTHING) is None
    assert legs.at(1.0).holds
    return asked[-1]


@pytest.mark.parametrize("manner", ["through", "parabola", "chord"])
def test_a_look_asks_about_all_that_the_arm_can_reach_in_a_second_and_little_more(manner):
    path, at_once = seam(), []
    parts = [(number, q) for number, part in enumerate(moved(path, manner)) for q in part[1:]]
    ahead = round(HORIZON_S / STEP_S)
    for now in range(0, len(parts) - ahead, 97):
        number, _ = parts[now + ahead]
        needed = 5 * number if manner == "through" else 5 * (number // 2) + 4 * (number % 2)
        last = looked_at(path, parts[now][1])
        assert last >= needed
        at_once.append(last - needed)
    assert len(at_once) > 5
    assert max(at_once) <= 10


def test_a_corner_in_reach_is_looked_at_whole():
    assert looked_at(seam(3), HOME, horizon_s=1e-3) == 4


def test_an_arm_beside_a_corner_is_off_its_path():
    outside = at(1.3 * TURN, -0.3 * LIFT)
    assert rest(joints(0.03), outside).cause == "off_path"


def test_what_stands_in_the_way_far_ahead_counts_once_it_is_in_reach():
    far = [JointLeg(at(0.8 * k * TURN), 0.1, 2.0) for k in (1, 2, 3, 4, 5)]
    path = BlendedPath(HOME, tuple(far))
    ball = Thing("ball", "rigid", Sphere(tuple(placed(at(4.0 * TURN))[0].tolist()), 0.03), 0.0)
    scene = Scene(objects=(ball,))
    assert ask(path, scene).index > 2
    assert rest(path, HOME, scene, authorised=1500).holds
    assert not rest(path, at(3.4 * TURN), scene, authorised=1500).holds

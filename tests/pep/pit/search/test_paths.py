"""Paths of several legs: the worst leg's answer, in the time of the whole; appending never lowers (P8)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.assessment.path_legs import LegsCertificate
from pep.pit.base.motion import profile_of
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.timed_course import line_drive
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.pep.pit.lines import placed, pose_of, random_line
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, random_move, random_scene, sweep, with_person

from pep.pit import JointLeg, JointPath, LineLeg, LinePath, MoveJ, MoveL, Sphere, Thing, assess, remaining

NAN, INF = math.nan, math.inf
PATIENT = replace(CELL, time_limit_s=60.0, watch_time_limit_s=60.0)  # a loaded machine that runs other tests meanwhile


def ask(motion, scene=None, cell=PATIENT, age=0.1):
    return assess(
        ROBOT, empty() if scene is None else scene, motion, cell, perception_age_s=age, touch=NOTHING, seed=SEED
    )


def joint_path(start, *targets, speed=0.5, acceleration=2.0, blend=0.0):
    return JointPath(start, tuple(JointLeg(t, speed, acceleration, blend) for t in targets))


def line_path(start, *poses, speed=0.25, acceleration=1.2, blend=0.0):
    return LinePath(start, tuple(LineLeg(p, speed, acceleration, blend) for p in poses))


def moved(pose, *by):
    return (*(np.array(pose[:3]) + by).tolist(), *pose[3:])


def at(base):
    return (base, *HOME[1:])


def test_a_path_of_one_leg_is_that_move():
    scene = with_person(0.9)
    move = sweep(0.5, 2.0)
    one, alone = ask(joint_path(move.start, move.target), scene), ask(move, scene)
    assert (one.tier, one.index, one.violations, one.clearance_m) == (
        alone.tier,
        alone.index,
        alone.violations,
        alone.clearance_m,
    )
    target = moved(pose_of(HOME), 0.05, -0.1, 0.02)
    line, single = ask(line_path(HOME, target), scene), ask(MoveL(HOME, target, 0.25, 1.2), scene)
    assert (line.tier, line.index, line.violations) == (single.tier, single.index, single.violations)
    assert line.lower_tier_speed is None


@pytest.mark.parametrize("seed", range(3))
def test_p8_appending_a_joint_leg_never_lowers_and_the_answer_is_the_worst_leg(seed):
    rng = np.random.default_rng(5000 + seed)
    scene, start = random_scene(rng, things=3, regions=2), random_move(rng, 0.6).start
    targets = [start]
    for _ in range(3):
        targets.append(tuple((np.array(targets[-1]) + rng.uniform(-0.3, 0.3, 6)).tolist()))
    alone = [ask(MoveJ(a, b, 0.5, 2.0), scene) for a, b in zip(targets, targets[1:])]
    for count in range(1, 4):
        whole = ask(joint_path(start, *targets[1 : count + 1]), scene)
        assert whole.index == max(a.index for a in alone[:count])
        assert set(whole.violations) == {v for a in alone[:count] for v in a.violations}
        assert whole.contact_ratio == max(a.contact_ratio for a in alone[:count])
        assert whole.speed_m_s == max(a.speed_m_s for a in alone[:count])
        assert isinstance(whole.certificate, LegsCertificate)
        assert len(whole.certificate.legs) == count


def test_p8_appending_a_line_never_lowers():
    rng = np.random.default_rng(51)
    scene = random_scene(rng, things=2, regions=2)
    first = random_line(rng)
    back = pose_of(first.start)
    one = ask(line_path(first.start, first.target), scene)
    two = ask(line_path(first.start, first.target, back), scene)
    three = ask(line_path(first.start, first.target, back, first.target), scene)
    assert one.index - RESOLUTION <= two.index <= three.index + RESOLUTION


def test_p8_splitting_at_waypoints_never_lowers_the_clearance_part():
    scene = with_person(0.9)
    whole = ask(sweep(0.3, 40.0), scene)
    parts = ask(joint_path(at(-0.6), at(-0.3), at(0.0), at(0.3), at(0.6), speed=0.3, acceleration=40.0), scene)
    assert parts.index >= whole.index - 2 * RESOLUTION
    target = moved(pose_of(HOME), 0.0, -0.2, 0.0)
    line = ask(line_path(HOME, target, speed=0.1, acceleration=50.0), scene)
    cut = ask(
        line_path(
            HOME, *(moved(pose_of(HOME), 0.0, -0.05 * k, 0.0) for k in (1, 2, 3, 4)), speed=0.1, acceleration=50.0
        ),
        scene,
    )
    assert cut.index >= line.index - 2 * RESOLUTION


def test_times_are_those_of_the_whole_path():
    """A thing that only the second leg meets is told at a time after the first leg has ended."""
    beyond, _ = placed(at(0.4))
    post = replace(empty(), objects=(Thing("post", "rigid", Sphere(tuple(beyond.tolist()), 0.01), 0.0),))
    path = joint_path(at(-0.6), at(-0.3), at(0.4))
    first = profile_of(MoveJ(at(-0.6), at(-0.3), 0.5, 2.0)).duration_s
    second = profile_of(MoveJ(at(-0.3), at(0.4), 0.5, 2.0)).duration_s
    cause = next(c for c in ask(path, post).contributions if c.object == "post")
    assert 1000 * first < cause.at_ms <= 1000 * (first + second) + 1
    alone = next(c for c in ask(MoveJ(at(-0.3), at(0.4), 0.5, 2.0), post).contributions if c.object == "post")
    assert cause.at_ms == pytest.approx(alone.at_ms + 1000 * first, abs=1)
    assert (cause.index_milli, cause.clearance_um) == (alone.index_milli, alone.clearance_um)


def test_the_second_line_starts_where_the_first_has_taken_the_joints():
    pose = pose_of(HOME)
    corner, end = moved(pose, 0.05, 0.0, 0.05), moved(pose, 0.05, -0.15, 0.05)
    drive = line_drive(ROBOT, HOME, corner, speed_m_s=0.25, acceleration_m_s2=1.2, check_time=lambda: None)
    there = tuple(drive.course.q(1.0).tolist())
    position, _ = placed(there)
    assert position == pytest.approx(np.array(corner[:3]), abs=1e-9)
    scene = with_person(0.7)
    worst = max(ask(MoveL(HOME, corner, 0.25, 1.2), scene).index, ask(MoveL(there, end, 0.25, 1.2), scene).index)
    assert ask(line_path(HOME, corner, end), scene).index == pytest.approx(worst, abs=1e-9)


def test_a_path_with_a_leg_that_is_not_proven_is_a_fault_and_one_beyond_a_limit_a_violation():
    pose = pose_of(HOME)
    answer = ask(line_path(HOME, moved(pose, 0.0, -0.05, 0.0), moved(pose, -2.0, 0, 0), pose))
    assert answer == ImpactFault("UNPROVEN", "unreachable")
    over = ask(joint_path(HOME, at(0.2), at(6.4), at(0.0)))
    assert over.violations == ("joint_limit",)
    assert over.tier == 4


LEG, LINE = JointLeg(at(0.1), 0.5, 2.0), LineLeg(moved(pose_of(HOME), 0.05, 0, 0), 0.25, 1.2)
BAD = [
    (JointPath(HOME, ()), "PARAMETERS_WRONG"),
    (LinePath(HOME, ()), "PARAMETERS_WRONG"),
    (JointPath(HOME, (LEG,) * 300), "PARAMETERS_WRONG"),
    *(
        (JointPath(HOME, (LEG, replace(LEG, blend_m=b))), r)
        for b, r in ((0.01, "OUT_OF_RANGE"), (-0.01, "OUT_OF_RANGE"), (NAN, "NOT_FINITE"), (INF, "NOT_FINITE"))
    ),
    *((LinePath(HOME, (LINE, replace(LINE, blend_m=b))), r) for b, r in ((0.01, "OUT_OF_RANGE"), (NAN, "NOT_FINITE"))),
    *(
        (JointPath(HOME, (LEG, replace(LEG, **{f: b}))), r)
        for f in ("speed_rad_s", "acceleration_rad_s2")
        for b, r in ((NAN, "NOT_FINITE"), (0.0, "OUT_OF_RANGE"))
    ),
    *(
        (LinePath(HOME, (LINE, replace(LINE, **{f: b}))), r)
        for f in ("speed_m_s", "acceleration_m_s2")
        for b, r in ((NAN, "NOT_FINITE"), (0.0, "OUT_OF_RANGE"), (1e9, "OUT_OF_RANGE"))
    ),
    (JointPath(HOME, (LEG, replace(LEG, target=HOME[:5]))), "PARAMETERS_WRONG"),
    (JointPath(HOME, (LEG, replace(LEG, target=(NAN, *HOME[1:])))), "NOT_FINITE"),
    (LinePath(HOME, (LINE, replace(LINE, target=(NAN, 0, 0, 0, 0, 0)))), "NOT_FINITE"),
    (LinePath(HOME, (LINE, replace(LINE, target=(50000.0, 0, 0, 0, 0, 0)))), "OUT_OF_RANGE"),
    (LinePath((INF, *HOME[1:]), (LINE,)), "NOT_FINITE"),
    (LinePath(HOME, (None,)), "PHYSICS_FAULT"),
    (LinePath(HOME, None), "PHYSICS_FAULT"),
]


@pytest.mark.parametrize(("motion", "reason"), BAD)
def test_p13_a_path_that_is_none_is_a_fault_with_its_reason(motion, reason):
    answer = ask(motion)
    assert isinstance(answer, ImpactFault)
    assert answer.reason == reason
    assert answer.reason in Reason.__members__


# ---- what is left of a path, and of a line


def left(motion, at_rad, milli, scene=None):
    return remaining(
        ROBOT,
        empty() if scene is None else scene,
        motion,
        PATIENT,
        at_rad=tuple(float(x) for x in at_rad),
        authorised_milli=milli,
        perception_age_s=0.1,
        touch=NOTHING,
    )


def test_what_the_verdict_proved_holds_for_every_rest_of_a_line_in_that_view():
    scene = with_person(0.9)
    move = MoveL(HOME, moved(pose_of(HOME), 0.05, -0.2, 0.02), 0.25, 1.2)
    answer = ask(move, scene)
    authorised = answer.reading().index_milli
    course = line_drive(ROBOT, HOME, move.target, speed_m_s=0.25, acceleration_m_s2=1.2, check_time=lambda: None).course
    for s in (0.0, 0.1, 0.5, 0.83, 1.0):
        rest = left(move, course.q(s), authorised, scene)
        assert rest.holds, (s, rest)
        assert rest.index_milli <= authorised
    lower = left(move, course.q(0.0), 1900, scene)
    assert (lower.holds, lower.cause) == (False, "person")


def test_an_arm_beside_its_line_is_off_the_path():
    move = MoveL(HOME, moved(pose_of(HOME), 0.05, -0.2, 0.02), 0.25, 1.2)
    course = line_drive(ROBOT, HOME, move.target, speed_m_s=0.25, acceleration_m_s2=1.2, check_time=lambda: None).course
    q = course.q(0.4)
    assert left(move, q + np.array([0.0005, 0, 0, 0, 0, 0]), 3000).holds
    off = left(move, q + np.array([0.02, 0, 0, 0, 0, 0]), 4000)
    assert (off.holds, off.cause) == (False, "off_path")


def test_somebody_steps_into_what_is_left_of_a_line_and_not_into_what_is_behind():
    start, end = at(0.5), moved(pose_of(at(0.5)), *(placed(at(-0.5))[0] - placed(at(0.5))[0]))
    move = MoveL(start, end, 0.1, 1.0)
    course = line_drive(ROBOT, start, end, speed_m_s=0.1, acceleration_m_s2=1.0, check_time=lambda: None).course
    begin, _ = placed(start)
    thing = Thing("post", "fragile", Sphere((float(begin[0]), float(begin[1]), float(begin[2])), 0.01), 0.0)
    scene = replace(empty(), objects=(thing,))
    assert ask(move, scene).index > 2.5
    assert not left(move, course.q(0.0), 2500, scene).holds
    assert left(move, course.q(0.95), 2500, scene).holds


def test_what_is_left_of_a_path_is_the_rest_of_its_leg_and_all_later_ones():
    beyond, _ = placed(at(0.4))
    post = replace(empty(), objects=(Thing("post", "rigid", Sphere(tuple(beyond.tolist()), 0.01), 0.0),))
    path = joint_path(at(-0.6), at(-0.3), at(0.4))
    assert left(path, at(-0.5), 2000).holds
    told = left(path, at(-0.5), 2000, post)
    assert (told.holds, told.cause) == (False, "rigid")
    assert left(path, at(-0.6), ask(path, post).reading().index_milli, post).holds
    off = left(path, at(1.0), 4000)
    assert (off.holds, off.cause) == (False, "off_path")
    pose = pose_of(HOME)
    lines = line_path(HOME, moved(pose, 0.0, -0.1, 0.0), moved(pose, 0.1, -0.1, 0.0))
    assert left(lines, HOME, ask(lines).reading().index_milli).holds


def test_a_line_that_is_not_proven_holds_never():
    move = MoveL(HOME, (*pose_of(HOME)[:3], *[x + 0.0 for x in pose_of(HOME)[3:]]), 0.25, 1.2)
    assert left(move, HOME, 0).holds
    half = replace(move, target=moved(_half(), 0.05, 0, 0))
    assert left(half, HOME, 4000) == ImpactFault("UNPROVEN", "half_turn")


def _half():
    import pinocchio

    position, rotation = placed(HOME)
    return (*position.tolist(), *pinocchio.log3(pinocchio.exp3(np.array([math.pi, 0, 0])) @ rotation).tolist())

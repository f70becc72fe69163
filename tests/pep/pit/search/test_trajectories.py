"""Timed trajectories: the curve through the points, the pieces around it, what is refused, and the answer."""

import os
import time
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from pep.pit.base.errors import MotionError
from pep.pit.base.timed_points import CLOSEST_S, DURATION_MOST_S, POINTS_MOST
from pep.pit.path.timed_curve import curve_of
from pep.pit.search.question import refuse_unreal
from pep.pit.search.timed_course import PastLimit
from pep.pit.search.trajectory_pieces import (
    HOLD_RAD,
    LAG_S,
    PIECES_MOST,
    RIPPLE,
    piece_drive,
    piece_drives,
    pieces_of,
    refuse_unfollowable,
)
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.campaign.timetables import planned, random_trajectory, served
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, with_person

from pep.pit import JointTrajectory, MoveJ, assess, remaining


PATIENT = replace(CELL, time_limit_s=600.0, watch_time_limit_s=600.0)
AGE_S = 0.05


def straight(*, way=1.0, lasts_s=2.0, count=11, speeds=True):
    """The first joint on its way with a speed that rises and falls smoothly."""
    times = np.linspace(0, lasts_s, count)
    s = times / lasts_s
    made, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / lasts_s
    points = np.array(HOME) + np.outer(made, [way, 0, 0, 0, 0, 0])
    stated = tuple(map(tuple, np.outer(rate, [way, 0, 0, 0, 0, 0]).tolist())) if speeds else ()
    return JointTrajectory(tuple(times.tolist()), tuple(map(tuple, points.tolist())), stated)


def answer(motion, scene=None):
    scene = empty() if scene is None else scene
    return assess(ROBOT, scene, motion, PATIENT, perception_age_s=AGE_S, touch=NOTHING, seed=SEED)


# ---- the curve


@pytest.mark.parametrize("seed", range(12))
def test_the_curve_meets_every_point_at_its_time_and_speed_and_nothing_jumps(seed):
    motion = random_trajectory(np.random.default_rng([64, seed]))
    curve = curve_of(motion)
    for number, (at, point) in enumerate(zip(motion.times_s, motion.points, strict=True)):
        q, v = curve.at(at)
        assert q == pytest.approx(point, abs=1e-12)
        if motion.speeds:
            assert v == pytest.approx(motion.speeds[number], abs=1e-9)
    assert np.abs(curve.at(0.0)[1]).max() == pytest.approx(0, abs=1e-12)
    step = np.diff(curve.t)[:, None]
    assert curve.q[1:] == pytest.approx(curve.q[:-1] + step * (curve.v[:-1] + 0.5 * step * curve.a), abs=1e-9)
    assert curve.v[1:] == pytest.approx(curve.v[:-1] + step * curve.a, abs=1e-8)
    times = np.linspace(0, curve.duration_s, 400)
    assert np.array([curve.at(t)[0] for t in times]) == pytest.approx(planned(motion, times), abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_without_stated_speeds_no_joint_leaves_the_angles_of_its_two_points(seed):
    motion = replace(random_trajectory(np.random.default_rng([65, seed])), speeds=())
    curve = curve_of(motion)
    for k, (since, until) in enumerate(zip(motion.times_s, motion.times_s[1:], strict=False)):
        low, high = np.sort([motion.points[k], motion.points[k + 1]], axis=0)
        for t in np.linspace(since, until, 30):
            q, _ = curve.at(t)
            assert (low - 1e-12 <= q).all() and (q <= high + 1e-12).all()


# ---- the pieces


@pytest.mark.parametrize("seed", range(8))
def test_what_an_arm_does_with_it_lies_in_its_pieces(seed):
    """Plan, servo and a stop on the way: each place is in the tube of some piece, and no faster."""
    assert uncovered(np.random.default_rng([66, seed])) == 0


@pytest.mark.campaign
def test_what_an_arm_does_with_ten_thousand_of_them_lies_in_their_pieces(capsys):
    """Sampled each millisecond; seeds and progress are shown."""
    missed, began, seen = [], time.monotonic(), 0
    for seed in range(CAMPAIGN):
        if uncovered(np.random.default_rng([67, seed])):
            missed.append(seed)
        seen += 1
        if seen % 500 == 0:
            with capsys.disabled():
                print(
                    f"\nseeds 67, 0 to {seed}: {len(missed)} missed {missed[:5]}, {time.monotonic() - began:.0f} s",
                    end="",
                )
    assert missed == []


CAMPAIGN = int(os.environ.get("TRAJECTORIES", "10000"))


def uncovered(rng):
    """Samples of what an arm does with a random trajectory that no piece holds, in place and speed at once."""
    motion = random_trajectory(rng)
    drives = [drive for _, drive in piece_drives(ROBOT, motion, CELL)]
    assert 0 < len(drives) <= PIECES_MOST
    if isinstance(drives[-1], PastLimit):
        return 0  # a violation, wherever else it goes
    ways = list(served(motion, rng))
    q, qd = (np.concatenate(rows) for rows in zip(*ways, strict=True))
    held = np.zeros(len(q), dtype=bool)
    for drive in drives:
        cells = drive.course.cells
        start, way, stray, hurry = drive.course.q(0.0), cells.dq[0], cells.stray[0], cells.hurry[0]
        # Each joint allows a range of places on the straight way; the tube holds the arm where all ranges meet.
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(q - start - stray) / way, (q - start + stray) / way])
        still = np.abs(way) < 1e-12
        ends[0][:, still] = np.where(np.abs(q - start)[:, still] <= stray[still], -np.inf, np.inf)
        ends[1][:, still] = -ends[0][:, still]
        low, high = np.maximum(ends.min(axis=0).max(axis=1), 0), np.minimum(ends.max(axis=0).min(axis=1), 1)
        rate = drive.profile.highest_rate(np.zeros(1), np.ones(1))[0]
        slow = (np.abs(qd) <= rate * (np.abs(way) + hurry) + 1e-9).all(axis=1)
        held |= (low <= high + 1e-12) & slow
    return int((~held).sum())


def test_pieces_tile_the_time_and_are_as_many_as_its_bending_needs():
    few, many = pieces_of(straight(lasts_s=8.0)), pieces_of(random_trajectory(np.random.default_rng(5)))
    for found in (few, many):
        assert found.pieces[0].since_s == 0
        assert [each.since_s for each in found.pieces[1:]] == list(found.ends_s[:-1])
    assert len(few.pieces) < len(many.pieces) <= PIECES_MOST


def test_a_piece_holds_the_stop_that_begins_on_it():
    (first, *_) = pieces_of(straight()).pieces[20:]
    drive = piece_drive(ROBOT, first, CELL)
    stop_rad = (RIPPLE * first.fastest_rad_s) ** 2 / (2 * CELL.stop_deceleration_rad_s2)
    share = abs(first.speed[0]) / first.fastest_rad_s
    longer = abs(drive.course.q(1.0)[0] - first.start[0]) - abs(first.speed[0]) * (first.until_s - first.since_s)
    assert longer == pytest.approx(stop_rad * share, rel=1e-9)
    assert (first.tube >= HOLD_RAD).all()
    assert (first.hurry >= 0.5 * first.acceleration * LAG_S).all()


# ---- the answer


def test_a_straight_plan_is_judged_as_the_joint_move_that_is_as_fast():
    """The tube and the ripple make it no more than a fifth worse."""
    plan, scene = straight(way=1.0), with_person(0.95, bearing=0.9)
    peak = curve_of(plan).fastest_rad_s
    move = answer(MoveJ(HOME, plan.points[-1], peak, 2.0), scene)
    found = answer(plan, scene)
    assert move.index <= found.index <= 1.2 * move.index
    assert move.tcp_speed_m_s <= found.tcp_speed_m_s <= 1.4 * move.tcp_speed_m_s
    assert found.certificate.proves(found.index)


def test_it_is_judged_as_timed_without_a_rest_at_each_point():
    """The same places in four times the time are a milder motion."""
    quick, scene = straight(speeds=False), with_person(0.95, bearing=0.9)
    slow = replace(quick, times_s=tuple(4 * each for each in quick.times_s))
    assert answer(slow, scene).index < answer(quick, scene).index - 0.1


def test_the_rest_of_it_holds_on_its_way_and_not_beside_it():
    motion = straight()
    at = curve_of(motion).at(1.0)[0]
    told = dict(authorised_milli=4000, perception_age_s=AGE_S, touch=NOTHING)
    on = remaining(ROBOT, empty(), motion, PATIENT, at_rad=tuple(at.tolist()), **told)
    assert on.holds, on
    off = remaining(ROBOT, empty(), motion, PATIENT, at_rad=tuple((at + [0, 0.05, 0, 0, 0, 0]).tolist()), **told)
    assert (off.holds, off.cause) == (False, "off_path")


def test_a_person_who_has_come_stands_against_the_rest():
    motion = straight()
    at = tuple(curve_of(motion).at(0.6)[0].tolist())
    rest = remaining(
        ROBOT,
        with_person(0.5),
        motion,
        PATIENT,
        at_rad=at,
        authorised_milli=1000,
        perception_age_s=AGE_S,
        touch=NOTHING,
    )
    assert (rest.holds, rest.cause) == (False, "person")


def test_a_way_near_a_joint_limit_is_refused_where_its_tube_passes_it():
    low, high = ROBOT.position_ranges_rad
    end = (float(high[0]) - 1e-3, *HOME[1:])
    start = (end[0] - 0.2, *HOME[1:])
    found = answer(JointTrajectory((0.0, 1.0), (start, end)))
    assert found.violations == ("joint_limit",)


# ---- what is no trajectory, or not this arm's

POINT = tuple(HOME)
NEXT = (0.1, *HOME[1:])


@pytest.mark.parametrize(
    ("motion", "reason", "place"),
    [
        (JointTrajectory((), ()), "PARAMETERS_WRONG", ""),
        (JointTrajectory((0.0,), (POINT,)), "PARAMETERS_WRONG", ""),
        (JointTrajectory((0.0, 1.0), (POINT,)), "PARAMETERS_WRONG", ""),
        (JointTrajectory((0.0, 1.0), (POINT, NEXT), (POINT,)), "PARAMETERS_WRONG", ""),
        (JointTrajectory((0.0, 1.0), (POINT, NEXT[:5])), "PARAMETERS_WRONG", "point 1"),
        (JointTrajectory((0.0, 1.0), (POINT, (nan, *NEXT[1:]))), "NOT_FINITE", "point 1"),
        (JointTrajectory((0.0, 1.0, 2.0), (POINT, NEXT, (inf, *NEXT[1:]))), "NOT_FINITE", "point 2"),
        (JointTrajectory((0.0, nan), (POINT, NEXT)), "NOT_FINITE", "point 1"),
        (JointTrajectory((0.5, 1.0), (POINT, NEXT)), "OUT_OF_RANGE", "point 0"),
        (JointTrajectory((0.0, 1.0, 1.0), (POINT, NEXT, POINT)), "OUT_OF_RANGE", "point 2"),
        (JointTrajectory((0.0, 1.0, 0.5), (POINT, NEXT, POINT)), "OUT_OF_RANGE", "point 2"),
        (JointTrajectory((0.0, CLOSEST_S / 2), (POINT, POINT)), "OUT_OF_RANGE", "point 1"),
        (JointTrajectory((0.0, DURATION_MOST_S + 1), (POINT, NEXT)), "OUT_OF_RANGE", "point 1"),
        (
            JointTrajectory(tuple(0.01 * n for n in range(POINTS_MOST + 1)), (POINT,) * (POINTS_MOST + 1)),
            "OUT_OF_RANGE",
            f"point {POINTS_MOST}",
        ),
        (JointTrajectory((0.0, 1.0), (POINT, NEXT), ((0.1,) * 6, (0.0,) * 6)), "OUT_OF_RANGE", "point 0"),
        (JointTrajectory((0.0, 1.0), (POINT, NEXT), ((0.0,) * 6, (0.1,) * 6)), "OUT_OF_RANGE", "point 1"),
        (JointTrajectory((0.0, 0.01), (POINT, NEXT)), "ROBOT_LIMIT", "point 1"),
        (JointTrajectory((0.0, 9.0), (POINT, (7.0, *HOME[1:]))), "ROBOT_LIMIT", "point 1"),
    ],
)
def test_what_is_no_trajectory_is_refused_with_its_point(motion, reason, place):
    with pytest.raises(MotionError) as raised:
        refuse_unreal(motion)
        refuse_unfollowable(ROBOT, motion)
    assert raised.value.reason == reason
    assert raised.value.detail.startswith(place)
    found = answer(motion)
    assert isinstance(found, ImpactFault) and found.reason == reason


def test_a_speed_that_no_joint_has_between_two_slow_points_counts():
    """Points that are far from each other's mean speed ask for more in between, and the index says so."""
    quick = (9.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    still = (0.0,) * 6
    motion = JointTrajectory((0.0, 0.5, 1.0), (POINT, NEXT, POINT), (still, quick, still))
    found = answer(motion)
    assert found.index == 4
    assert "joint_speed" in {each.kind for each in found.contributions}

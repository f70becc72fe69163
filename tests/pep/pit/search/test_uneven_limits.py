"""Joints that turn farther one way: each limit counts its own way, for every form of motion (PHY-42)."""

import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from pep.pit.assessment.assessment import Assessment
from pep.pit.assessment.remaining import remaining
from pep.pit.search.start_violations import joint_limits
from pep.pit.search.timed_course import beyond
from tests.pep.pit.lines import pose_of
from tests.pep.pit.scenes import CELL, HOME, NOTHING, SEED, empty

from pep.pit import JointLeg, JointPath, LineLeg, LinePath, MoveJ, MoveL, Robot, ServoJ, SpeedJ, SpeedL, assess

TEXT = (resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
LOW, HIGH = -1.0, 1.5


def with_elbow(low, high):
    """The UR3e with an elbow that turns from `low` to `high`, rad."""
    limits = f"position_low_rad = {low}\nposition_limit_rad = {high}"
    return Robot.from_toml(TEXT.replace("position_limit_rad = 3.141592653589793", limits, 1), tool="robotiq_2f85")


ROBOT, MIRRORED = with_elbow(LOW, HIGH), with_elbow(-HIGH, -LOW)


def at(elbow):
    return (*HOME[:2], elbow, *HOME[3:])


def ask(motion, robot=ROBOT):
    answer = assess(robot, empty(), motion, CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert isinstance(answer, Assessment), answer
    return answer


def broken(motion, robot=ROBOT):
    answer = ask(motion, robot)
    assert (answer.tier == 4) >= ("joint_limit" in answer.violations)
    return "joint_limit" in answer.violations


def motions(start, target):
    """The same way of the elbow in every form that has one; a held one goes a little farther."""
    way = target - start
    yield MoveJ(at(start), at(target), 0.3, 1.0)
    yield JointPath(at(start), (JointLeg(at(start + way / 2), 0.3, 1.0), JointLeg(at(target), 0.3, 1.0)))
    yield SpeedJ(
        at(start), tuple(math.copysign(0.4, way) if k == 2 else 0.0 for k in range(6)), 1.0, abs(way) / 0.4 + 0.4
    )
    yield MoveL(at(start), pose_of(at(target)), 0.1, 1.0)
    yield LinePath(at(start), (LineLeg(pose_of(at(target)), 0.1, 1.0),))
    yield ServoJ(at(start), (0.0,) * 6, at(target), 0.002, 0.2)


@pytest.mark.parametrize(("start", "target"), [(1.25, 1.45), (-0.8, -0.9), (0.7, 1.2), (1.0, 1.3)])
def test_inside_the_wider_limit_nothing_is_broken(start, target):
    """These angles are beyond or near the narrower limit taken both ways; the joint may have them."""
    move, path, _, line, lines, _ = motions(start, target)
    for motion in (move, path, line, lines):
        assert not broken(motion), motion


@pytest.mark.parametrize(("start", "target"), [(1.4, 1.6), (-0.9, -1.1), (1.4, 1.501), (-0.9, -1.001)])
def test_each_limit_is_broken_in_its_own_place(start, target):
    for motion in motions(start, target):
        assert broken(motion), motion


def test_a_held_tool_speed_meets_the_limit_of_its_side():
    position = np.array(pose_of(at(1.4))[:3]) - np.array(pose_of(at(1.3))[:3])
    twist = (*(0.1 * position / np.linalg.norm(position)).tolist(), 0.0, 0.0, 0.0)
    assert broken(SpeedL(at(1.4), twist, 1.0, 0.6)) != broken(SpeedL(at(1.4), tuple(-x for x in twist), 1.0, 0.6))


def test_the_mirrored_arm_has_the_mirrored_limits():
    assert not broken(MoveJ(at(-1.25), at(-1.45), 0.3, 1.0), MIRRORED)
    assert broken(MoveJ(at(-1.4), at(-1.6), 0.3, 1.0), MIRRORED)
    assert broken(MoveJ(at(0.9), at(1.1), 0.3, 1.0), MIRRORED)


def test_the_way_back_and_the_way_across():
    """From beyond either limit inwards is a retreat; from beyond the one to beyond the other is none, however far."""
    for out, back in ((1.7, 1.6), (1.7, 0.0), (-1.3, -1.2), (-1.3, 0.5)):
        answer = ask(MoveJ(at(out), at(back), 0.3, 1.0))
        assert (answer.violations, answer.tier) == ((), 3), (out, back)
    for out, there in ((1.7, 1.8), (-1.3, -1.4), (1.9, -1.1), (-1.5, 1.6)):
        assert broken(MoveJ(at(out), at(there), 0.3, 1.0)), (out, there)


def test_the_law_itself():
    rng = np.random.default_rng(5)
    low, high = ROBOT.position_ranges_rad
    for _ in range(2000):
        start, target = rng.uniform(-2, 2, (2, 6))
        found = joint_limits(ROBOT, start, target)
        over = [(q - high).clip(0) for q in (start, target)]
        under = [(low - q).clip(0) for q in (start, target)]
        worse = (over[1] > over[0]) | (under[1] > under[0])
        assert found.broken == bool(worse.any())
        assert found.retreating == bool((over[0] > 0).any() or (under[0] > 0).any())
        assert beyond(ROBOT, start) == found.retreating
        assert beyond(ROBOT, start, np.full(6, 0.1)) == bool(((start + 0.1 > high) | (start - 0.1 < low)).any())


def test_what_is_no_number_is_beyond():
    strange = np.array([0.0, math.nan, 0.0, 0.0, 0.0, 0.0])
    assert joint_limits(ROBOT, np.zeros(6), strange).broken
    assert beyond(ROBOT, strange)
    assert beyond(ROBOT, np.zeros(6), strange)


def test_the_watch_holds_to_the_same_limits():
    move = MoveJ(at(1.25), at(1.45), 0.3, 1.0)
    asked = {"authorised_milli": 4000, "perception_age_s": 0.1, "touch": NOTHING}
    assert remaining(ROBOT, empty(), move, CELL, at_rad=at(1.3), **asked).holds
    assert not remaining(ROBOT, empty(), replace(move, target=at(1.6)), CELL, at_rad=at(1.3), **asked).holds

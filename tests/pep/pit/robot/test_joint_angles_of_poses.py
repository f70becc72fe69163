"""Joint angles of tool poses: the nearest, those on a branch, and poses without clear ones."""

import math

import numpy as np
import pytest
from pep.pit.base.errors import UnprovenError
from pep.pit.robot.inverse_kinematics import followed, joint_speeds, nearest
from tests.pep.pit.lines import placed, pose_of, random_start
from tests.pep.pit.scenes import HOME, ROBOT


def detail(ask, pose, near):
    with pytest.raises(UnprovenError) as refused:
        ask(ROBOT, pose, near)
    return refused.value.detail


def flipped(q):
    """Joint angles of the same pose, with the wrist about the other way round."""
    return nearest(ROBOT, pose_of(q), (*q[:3], q[3] + math.pi, -q[4], q[5] - math.pi))


@pytest.mark.parametrize("seed", [0, 1, 3, 4, 5, 6])
def test_they_reach_the_pose_and_no_known_others_are_nearer(seed):
    rng = np.random.default_rng(seed)
    near = random_start(rng)
    there = tuple((np.array(near) + rng.uniform(-0.5, 0.5, 6)).tolist())
    q = nearest(ROBOT, pose_of(there), near)
    for mine, theirs in zip(placed(q), placed(there), strict=True):
        assert np.abs(mine - theirs).max() < 1e-9
    assert max(abs(a - b) for a, b in zip(q, near, strict=True)) <= 0.5 + 1e-9


def test_a_whole_turn_is_taken_where_it_is_nearer():
    near = (*HOME[:5], 5.0)
    assert nearest(ROBOT, pose_of((*HOME[:5], 5.3)), near)[5] == pytest.approx(5.3)
    assert nearest(ROBOT, pose_of((*HOME[:5], 5.3)), HOME)[5] == pytest.approx(5.3 - 2 * math.pi)


def test_beyond_a_joints_range_another_turn_is_taken():
    there = (6.4 - 2 * math.pi, *HOME[1:])
    assert nearest(ROBOT, pose_of(there), (6.2, *HOME[1:]))[0] == pytest.approx(there[0])


def test_without_clear_angles_there_are_none():
    assert detail(nearest, (1.5, 0.0, 0.3, 0.0, 3.1, 0.0), HOME) == "unreachable"
    straight = (*HOME[:4], 1e-3, HOME[5])
    assert detail(nearest, pose_of(straight), straight) == "singular"
    assert detail(followed, pose_of(straight), straight) == "singular"
    half = tuple((a + b) / 2 for a, b in zip(HOME, flipped(HOME), strict=True))
    assert np.abs(np.array(half) - HOME).max() > 1
    assert detail(nearest, pose_of(HOME), half) == "ambiguous"


def test_a_pose_a_short_way_off_keeps_its_branch_and_one_far_off_is_none():
    q = HOME
    for step in range(50):
        there = tuple(a + 0.01 * math.sin(step + axis) for axis, a in enumerate(q))
        q = followed(ROBOT, pose_of(there), q)
        assert q == pytest.approx(there, abs=1e-8)
    assert detail(followed, (1.5, 0.0, 0.3, 0.0, 3.1, 0.0), HOME) == "unreachable"


def led(twist, *, every_s, seconds=2.0, step_s=0.002):
    """Joint angles after joint speeds that were computed anew so often, and the farthest the tool was off its line."""
    q, off = np.array(HOME), 0.0
    begun, _ = placed(HOME)
    for step in range(round(seconds / step_s)):
        if step % round(every_s / step_s) == 0:
            speeds = np.array(joint_speeds(ROBOT, twist, tuple(q)))
        q = q + step_s * speeds
        position, _ = placed(tuple(q))
        off = max(off, float(np.abs(position - begun - (step + 1) * step_s * np.array(twist[:3])).max()))
    return q, off


def test_joint_speeds_that_are_computed_anew_keep_the_tool_on_its_line_and_others_do_not():
    along = (0.05, -0.03, 0.02, 0.0, 0.0, 0.0)
    q, off = led(along, every_s=0.02)
    assert off < 0.5e-3
    assert np.abs(placed(tuple(q))[1] - placed(HOME)[1]).max() < 5e-3
    assert led(along, every_s=2.0)[1] > 5e-3


def test_no_joint_is_faster_than_a_stream_of_joint_speeds_may_be():
    twist = (0.0, 0.0, 0.0, 0.0, 0.1, 0.2)
    assert max(map(abs, joint_speeds(ROBOT, twist, HOME))) < 1
    with pytest.raises(UnprovenError) as refused:
        joint_speeds(ROBOT, twist, (*HOME[:4], 0.0, HOME[5]))
    assert refused.value.detail == "singular"
    with pytest.raises(UnprovenError):
        joint_speeds(ROBOT, tuple(20 * each for each in twist), HOME)

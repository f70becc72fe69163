"""Goals of planners: what is followed, and what is refused with which code."""

import math
from types import SimpleNamespace as Message

import pytest
from ztpm_ros2.goal import JOINTS, KEPT_RAD, GoalError, ResultCode, asked, missed

pytestmark = pytest.mark.clause("LSD-24")

NAMES = [f"{joint}_joint" for joint in JOINTS]
HOME = (0.0, -1.5, 1.5, -1.5, -1.5, 0.0)


def point(at_s, positions, velocities=()):
    sec = int(at_s)
    return Message(
        positions=list(positions), velocities=list(velocities), accelerations=[], effort=[],
        time_from_start=Message(sec=sec, nanosec=round((at_s - sec) * 1e9)),
    )  # fmt: skip


def goal(points, names=NAMES, stamp=(0, 0), path=(), end=()):
    return Message(
        trajectory=Message(
            header=Message(stamp=Message(sec=stamp[0], nanosec=stamp[1])), joint_names=list(names), points=points
        ),
        multi_dof_trajectory=Message(points=[]),
        path_tolerance=[Message(name=name, position=most) for name, most in path],
        goal_tolerance=[Message(name=name, position=most) for name, most in end],
    )


def read(wanted, prefix="", now_s=1000.0):
    return asked(wanted, prefix=prefix, standing=HOME, now_s=now_s)


def refused(wanted, **options):
    with pytest.raises(GoalError) as wrong:
        read(wanted, **options)
    return wrong.value.code, str(wrong.value).partition(":")[0]


MOVE = [point(0.0, HOME), point(1.5, (0.3, *HOME[1:]))]


def test_joints_are_put_in_the_arms_order_whatever_the_planners_is():
    order = [5, 3, 0, 1, 4, 2]
    shuffled = [point(at, [q[k] for k in order]) for at, q in ((0.0, HOME), (1.5, (0.3, *HOME[1:])))]
    found = read(goal(shuffled, [NAMES[k] for k in order]))
    assert found == read(goal(MOVE))
    assert (found.times_s, found.points[0]) == ((0.0, 1.5), HOME)


def test_a_first_point_later_than_0_is_gone_to_from_where_the_arm_stands():
    found = read(goal([point(1.0, (0.2, *HOME[1:]), (0.1,) * 6), point(2.0, (0.3, *HOME[1:]), (0.0,) * 6)]))
    assert (found.points[0], found.speeds[0], found.times_s) == (HOME, (0.0,) * 6, (0.0, 1.0, 2.0))


def test_a_prefix_stands_before_every_joint():
    prefixed = [f"left_{name}" for name in NAMES]
    assert read(goal(MOVE, prefixed), prefix="left_") == read(goal(MOVE))
    assert refused(goal(MOVE, prefixed)) == (ResultCode.INVALID_JOINTS, "PARAMETERS_WRONG")
    assert refused(goal(MOVE), prefix="left_") == (ResultCode.INVALID_JOINTS, "PARAMETERS_WRONG")


@pytest.mark.parametrize(
    "names", [[], NAMES[:5], [*NAMES, "gripper"], [*NAMES[:5], NAMES[0]], [*NAMES[:5], "wrist_4_joint"]]
)
def test_other_joints(names):
    code, _ = refused(goal(MOVE, names))
    assert code in (ResultCode.INVALID_JOINTS, ResultCode.INVALID_GOAL)


@pytest.mark.parametrize(
    ("stamp", "code"), [((999, 0), ResultCode.OLD_HEADER_TIMESTAMP), ((1001, 0), ResultCode.INVALID_GOAL)]
)
def test_a_trajectory_begins_at_once(stamp, code):
    assert refused(goal(MOVE, stamp=stamp)) == (code, "PARAMETERS_WRONG")


@pytest.mark.parametrize(
    "points",
    [
        [],
        [point(0.0, HOME)],
        [point(0.0, HOME), point(0.0, HOME)],
        [point(1.0, HOME), point(0.5, HOME)],
        [point(0.0, HOME), point(1.0, (math.nan, *HOME[1:]))],
        [point(0.0, HOME), point(1.0, HOME[:5])],
        [point(0.0, HOME, (0.0,) * 6), point(1.0, HOME)],
    ],
)
def test_points_that_are_no_trajectory(points):
    assert refused(goal(points))[0] is ResultCode.INVALID_GOAL


def test_several_degrees_of_freedom_at_once_are_no_joints_of_an_arm():
    wanted = goal(MOVE)
    wanted.multi_dof_trajectory.points = [object()]
    assert refused(wanted) == (ResultCode.INVALID_GOAL, "PARAMETERS_WRONG")


@pytest.mark.parametrize("most", [1e-4, math.nan, math.inf])
def test_a_path_is_not_promised_narrower_than_it_is_kept(most):
    assert refused(goal(MOVE, path=[(NAMES[0], most)])) == (ResultCode.INVALID_GOAL, "OUT_OF_RANGE")


@pytest.mark.parametrize("most", [0.0, -1.0, KEPT_RAD, 0.2])
def test_a_wider_tolerance_or_none_asks_nothing(most):
    assert read(goal(MOVE, path=[(NAMES[0], most)])) == read(goal(MOVE))


def test_a_goal_is_missed_outside_of_its_own_tolerance_alone():
    wanted = goal(MOVE, end=[(NAMES[0], 0.01), (NAMES[1], 0.0)])
    end = MOVE[-1].positions
    assert missed(wanted, end, (0.295, -1.2, *end[2:]), prefix="") == ""
    assert missed(wanted, end, (0.28, *end[1:]), prefix="").startswith("shoulder_pan")
    assert missed(wanted, end, (math.nan, *end[1:]), prefix="")

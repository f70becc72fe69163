"""Goals of `control_msgs/action/FollowJointTrajectory`, read strictly, and the codes of its results."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final

from pep.pit.base.errors import PitError
from pep.pit.files.trajectory_file import trajectory_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit import JointTrajectory

JOINTS: Final = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""The arm's names of its joints, from its base on; planners' may end in `_joint`."""
KEPT_RAD: Final = 0.05
"""Ours: narrowest tolerance of a path that is taken. The gateway's own tube about usual trajectories is narrower."""


class ResultCode(IntEnum):
    """Codes of `FollowJointTrajectory.Result`, as in ROS 2 Humble to Kilted."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalError(Exception):
    """A goal that cannot be followed; `code` is for the result, and the text begins with a reason code."""

    def __init__(self, code: ResultCode, told: str) -> None:
        super().__init__(told)
        self.code = code


def asked(goal: Any, *, prefix: str, standing: Sequence[float], now_s: float) -> JointTrajectory:
    """The trajectory that a goal asks for, in the arm's order of joints.

    A first point later than 0 is gone to from where the arm stands, as controllers of ros2_control do.

    Args:
        goal: `FollowJointTrajectory.Goal`, or any object with its members.
        prefix: what stands before each joint's name; "" for nothing.
        standing: joint angles of the arm now, (6,), rad.
        now_s: ROS time, s.

    Raises:
        GoalError: the goal names other joints, begins at another time, has points that are no trajectory, or wants a
            narrower path than is kept.
    """
    message = goal.trajectory
    _refuse_another_time(message.header.stamp, now_s)
    if getattr(getattr(goal, "multi_dof_trajectory", None), "points", ()):
        raise GoalError(ResultCode.INVALID_GOAL, "PARAMETERS_WRONG: multi_dof_trajectory: the arm has single joints")
    names = [name.removeprefix(prefix) for name in message.joint_names]
    known = {word for joint in JOINTS for word in (joint, f"{joint}_joint")}
    if (
        len(names) != len(JOINTS)
        or not known.issuperset(names)
        or any(not name.startswith(prefix) for name in message.joint_names)
    ):
        wanted = ", ".join(f"{prefix}{joint}_joint" for joint in JOINTS)
        raise GoalError(ResultCode.INVALID_JOINTS, f"PARAMETERS_WRONG: joint_names: {wanted} are wanted, once each")
    _refuse_narrow(goal)
    points = [_point(at, each) for at, each in enumerate(message.points)]
    if points and points[0]["time_from_start"] != {"sec": 0, "nanosec": 0}:
        here = dict(zip(JOINTS, standing, strict=True))
        first = [here[name.removesuffix("_joint")] for name in names]
        still = [0.0] * len(names) if points[0]["velocities"] else []
        points.insert(0, {"positions": first, "velocities": still, "time_from_start": {"sec": 0, "nanosec": 0}})
    try:
        return trajectory_of({"joint_names": names, "points": points}, JOINTS)
    except PitError as error:
        raise GoalError(ResultCode.INVALID_GOAL, f"{error.reason}: {error.detail}") from error


def missed(goal: Any, wanted: Sequence[float], reached: Sequence[float], *, prefix: str) -> str:
    """The first joint outside of the goal's own tolerance at the end, in words; "" where there is none."""
    allowed = {each.name.removeprefix(prefix).removesuffix("_joint"): each.position for each in goal.goal_tolerance}
    for joint, there, here in zip(JOINTS, wanted, reached, strict=True):
        most = allowed.get(joint, 0.0)
        if most > 0.0 and not abs(there - here) <= most:
            return f"{joint} stands {abs(there - here):.5f} rad from its goal, and {most} is allowed"
    return ""


def _point(at: int, point: Any) -> dict[str, Any]:
    since = point.time_from_start
    if not all(map(math.isfinite, (*point.positions, *point.velocities, *point.accelerations))):
        raise GoalError(ResultCode.INVALID_GOAL, f"NOT_FINITE: points[{at}]: every number is finite")
    return {
        "positions": list(point.positions),
        "velocities": list(point.velocities),
        "accelerations": list(point.accelerations),
        "effort": list(point.effort),
        "time_from_start": {"sec": since.sec, "nanosec": since.nanosec},
    }


def _refuse_another_time(stamp: Any, now_s: float) -> None:
    """A stamp of 0 is now; the gateway begins what it permits at once, so there is no other time."""
    at_s = stamp.sec + stamp.nanosec * 1e-9
    if at_s == 0.0:
        return
    if at_s < now_s:
        raise GoalError(ResultCode.OLD_HEADER_TIMESTAMP, "PARAMETERS_WRONG: header.stamp is over; leave it 0")
    raise GoalError(ResultCode.INVALID_GOAL, "PARAMETERS_WRONG: header.stamp: a trajectory begins at once; leave it 0")


def _refuse_narrow(goal: Any) -> None:
    for each in goal.path_tolerance:
        if not math.isfinite(each.position) or 0.0 < each.position < KEPT_RAD:
            told = f"{each.name}: {each.position} rad is not promised; {KEPT_RAD} is, and 0 asks nothing"
            raise GoalError(ResultCode.INVALID_GOAL, f"OUT_OF_RANGE: path_tolerance: {told}")

"""Arrival of an arm at the end of its motion, by the model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit import BlendedPath, JointLeg, JointPath, JointTrajectory, LineLeg, MoveJ, MoveL
from pep.pit.robot.calibration import nominal_error_m
from pep.pit.robot.inverse_kinematics import stance
from pep.pit.robot.twist import turn_of, turned_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit import Motion, Robot

JOINT_RAD: Final = 1e-3
"""A joint this near to its target has arrived; the controller holds about a tenth of it."""
TOOL_M: Final = 1e-3
"""Distance at which a tool has arrived, beside the error of nominal kinematics.

A controller has its arm's own kinematics, a model may have nominal ones.
"""
TOOL_RAD: Final = 0.02
"""Ours: turn of the tool at which it has arrived."""


def arrived(motion: Motion | None, robot: Robot, q_rad: Sequence[float]) -> bool:
    """True where these joint angles are the end of the motion; False for a motion without an end.

    Args:
        motion: as it was assessed.
        robot: the arm.
        q_rad: measured joint angles, six.
    """
    match motion:
        case MoveJ(target=target):
            return _near(q_rad, target)
        case JointPath(legs=legs):
            return _near(q_rad, legs[-1].target)
        case JointTrajectory(points=points):
            return _near(q_rad, points[-1])
        case BlendedPath(legs=(*_, JointLeg(target=target))):
            return _near(q_rad, target)
        case MoveL(target=pose) | BlendedPath(legs=(*_, LineLeg(target=pose))):
            here = stance(robot, np.array(q_rad, dtype=float))
            off = turn_of(turned_by(np.array(pose[3:])) @ here.rotation.T)
            return bool(
                np.linalg.norm(np.array(pose[:3]) - here.position) <= nominal_error_m(robot.model) + TOOL_M
                and np.linalg.norm(off) <= TOOL_RAD
            )
        case _:
            return False


def _near(q_rad: Sequence[float], target: Sequence[float]) -> bool:
    return all(abs(a - b) <= JOINT_RAD for a, b in zip(q_rad, target, strict=True))

"""Joint angles of tool poses, and poses of joint angles, by the cell's own model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.errors import UnprovenError
from pep.pit.robot.inverse_kinematics import followed, joint_speeds, nearest
from pep.pit.robot.twist import tool_pose, turn_of
from policies.evidence.evidence import ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Joints, Pose
    from pep.world.held_object import CommittedGrip


class ToolPoses:
    """`pep.rtde.judge.pose_targets.Posing` of the arm as it is held now. Radians and metres.

    Args:
        holding: its model, with what it holds.
    """

    def __init__(self, holding: CommittedGrip) -> None:
        self._holding = holding

    def nearest(self, pose: Pose, near: Joints) -> Joints | ImpactFault:
        """Joint angles of a pose, of all found the nearest; milliseconds ([PHY-56])."""
        return _told(lambda: nearest(self._holding.robot, pose, near))

    def followed(self, pose: Pose, near: Joints) -> Joints | ImpactFault:
        """Joint angles of a pose a short way from others, on their branch; half a millisecond ([PHY-57])."""
        return _told(lambda: followed(self._holding.robot, pose, near))

    def speeds(self, twist: Pose, at: Joints) -> Joints | ImpactFault:
        """Joint speeds that make a tool speed at joint angles; a tenth of a millisecond ([PHY-69])."""
        return _told(lambda: joint_speeds(self._holding.robot, twist, at))

    def pose_of(self, q_rad: Joints) -> Pose:
        """Pose of the tool at six joint angles."""
        position, rotation = tool_pose(self._holding.robot, np.array(q_rad))
        x, y, z, rx, ry, rz = np.concatenate([position, turn_of(rotation)]).tolist()
        return x, y, z, rx, ry, rz


def _told(ask: Callable[[], Joints]) -> Joints | ImpactFault:
    try:
        return ask()
    except UnprovenError as error:
        return ImpactFault(error.reason, error.detail)

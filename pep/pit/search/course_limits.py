"""Demands of a course on the arm itself, as ratios to configured limits, as of a straight move.

Speeds and momentum are proven bounds. Accelerations and torque are sampled in the middle of each cell, with no proof.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pep.pit.path.straight_path import GRID
from pep.pit.search.arm_limits import Ratio, body_ratios
from pep.pit.search.torques import Torques

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats, Profile
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.timed_course import TimedCourse


class Effort:
    """Demands of a drive: parts without its timing, computed once, and ratios for any profile."""

    def __init__(self, robot: Robot, drive: TimedCourse, cell: CellParameters) -> None:
        """Computes torque and speed terms of every cell."""
        self._robot, self._drive, self._cell = robot, drive, cell
        cells = drive.course.cells
        self._rush = drive.course.rush(cells.low, cells.high)
        self._torques = Torques(robot, cell, cells.q, cells.dq, cells.ddq)

    def surface_speed_m_s(self, profile: Profile) -> Floats:
        """Proven bound on the surface speed of every body of the robot over the whole course, shape (bodies,)."""
        cells = self._drive.course.cells
        rate = profile.highest_rate(cells.low / GRID, cells.high / GRID)
        return np.asarray((self._rush * rate[:, None]).max(axis=0))

    def joint_acceleration_rad_s2(self, profile: Profile, *, stretched: float = 1.0) -> Floats:
        """Highest acceleration of each joint in the middle of any cell, under the profile, (6,)."""
        cells = self._drive.course.cells
        rate = profile.highest_rate(cells.low / GRID, cells.high / GRID)[:, None]
        met = np.abs(cells.dq) * (max(self._drive.push) * stretched**2) + np.abs(cells.ddq) * rate**2
        return np.asarray(met.max(axis=0))

    def ratios(self, profile: Profile, *, stretched: float = 1.0) -> tuple[Ratio, ...]:
        """Every quantity of this drive under this profile against its limit.

        Args:
            profile: the drive's own, or the same at another speed.
            stretched: every rate is this fraction of the drive's own, so that accelerations are its square.
        """
        robot, cell, drive = self._robot, self._cell, self._drive
        joint = drive.joint_speeds_rad_s(profile).max(axis=0) / robot.speed_limits_rad_s
        hardest = self.joint_acceleration_rad_s2(profile, stretched=stretched) / robot.model.acceleration_limit_rad_s2
        speeds = self.surface_speed_m_s(profile)
        forward, backward = (each * stretched**2 for each in drive.push)
        rate = profile.rate(drive.course.cells.mid / GRID)
        tool = float(speeds[robot.body_index("tcp")])
        # A short line never reaches a forbidden speed, but asking for one is asking to break the limit.
        asked = drive.tool_speed_m_s * profile.speed_rad_s / drive.profile.speed_rad_s
        tool = asked if asked > cell.tcp_speed_limit_m_s else tool
        return (
            Ratio("joint_speed", float(joint.max())),
            Ratio("acceleration", float(hardest.max())),
            *body_ratios(
                robot,
                cell,
                speeds,
                tool_speed_m_s=tool,
                torque=lambda: self._torques.ratio(rate, forward=forward, backward=backward),
            ),
        )

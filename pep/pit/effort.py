"""What a course asks of the arm itself, as ratios to configured limits: the same quantities as of a straight move.

Speeds and momentum are proven bounds. Accelerations and torque are sampled in the middle of each cell, with no proof.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio

from pep.pit.contact import payload_kg
from pep.pit.parameters import Ratio
from pep.pit.path import GRID

if TYPE_CHECKING:
    from pep.pit.cell import CellParameters
    from pep.pit.drive import Drive
    from pep.pit.motion import Floats, Profile
    from pep.pit.robot import Robot


class Effort:
    """What a drive demands: the parts that do not depend on its timing, computed once, then ratios for any profile."""

    def __init__(self, robot: Robot, drive: Drive, cell: CellParameters) -> None:
        """Torque and speed terms of every cell."""
        self._robot, self._drive, self._cell = robot, drive, cell
        cells = drive.course.cells
        self._rush = drive.course.rush(cells.low, cells.high)
        # What is carried and is no body of the robot counts at the tool point.
        self._carried_kg = robot.model.payload_limit_kg if cell.payload_kg is None else cell.payload_kg
        self._hold, self._push, self._swing = self._torque_terms()

    def _torque_terms(self) -> tuple[Floats, Floats, Floats]:
        """Per cell the torque to hold, per unit of s'' and per s' squared, each of shape (n, 6)."""
        robot, cells = self._robot, self._drive.course.cells
        model = robot.pinocchio
        if self._carried_kg > 0:
            model = pinocchio.Model(model)
            part = pinocchio.Inertia(self._carried_kg, np.array(robot.tool.tcp_m), np.zeros((3, 3)))
            model.inertias[len(robot.model.joints)] += part
        scratch = model.createData()
        still = np.zeros(len(robot.model.joints))
        rows = list(zip(cells.q, cells.dq, cells.ddq, strict=True))
        hold = np.array([pinocchio.rnea(model, scratch, q, still, still) for q, _, _ in rows])
        push = np.array([pinocchio.rnea(model, scratch, q, still, dq) for q, dq, _ in rows])
        swing = np.array([pinocchio.rnea(model, scratch, q, dq, ddq) for q, dq, ddq in rows])
        return hold, push - hold, swing - hold

    def surface_speed_m_s(self, profile: Profile) -> Floats:
        """Proven bound on the surface speed of every body of the robot over the whole course, shape (bodies,)."""
        cells = self._drive.course.cells
        rate = profile.highest_rate(cells.low / GRID, cells.high / GRID)
        return np.asarray((self._rush * rate[:, None]).max(axis=0))

    def joint_acceleration_rad_s2(self, profile: Profile) -> Floats:
        """Highest acceleration of each joint in the middle of any cell, with what the profile may have there, (6,)."""
        cells = self._drive.course.cells
        rate = profile.highest_rate(cells.low / GRID, cells.high / GRID)[:, None]
        met = np.abs(cells.dq) * max(self._drive.push) + np.abs(cells.ddq) * rate**2
        return np.asarray(met.max(axis=0))

    def ratios(self, profile: Profile) -> tuple[Ratio, ...]:
        """Every quantity of this drive under this profile against its limit."""
        robot, cell = self._robot, self._cell
        joint = self._drive.joint_speeds_rad_s(profile).max(axis=0) / robot.speed_limits_rad_s
        hardest = self.joint_acceleration_rad_s2(profile) / robot.model.acceleration_limit_rad_s2
        speeds = self.surface_speed_m_s(profile)
        tool = float(speeds[robot.body_index("tcp")])
        # A short line never reaches a forbidden speed, but asking for one is asking to break the limit.
        asked = self._drive.tool_speed_m_s * profile.speed_rad_s / self._drive.profile.speed_rad_s
        found = [Ratio("joint_speed", float(joint.max())), Ratio("acceleration", float(hardest.max()))]
        found.append(
            Ratio("tcp_speed", (asked if asked > cell.tcp_speed_limit_m_s else tool) / cell.tcp_speed_limit_m_s)
        )
        found.append(Ratio("elbow_speed", float(speeds[robot.body_index("elbow_point")]) / cell.elbow_speed_limit_m_s))
        masses = {f"com_{j.name}": j.mass_kg for j in robot.model.joints} | {"com_tool": robot.tool.mass_kg}
        if robot.held is not None:
            masses["com_payload"] = robot.model.payload_limit_kg if robot.held.mass_kg is None else robot.held.mass_kg
        moving = zip(robot.bodies, speeds, strict=True)
        momentum = sum(masses[b.name] * float(v) for b, v in moving if b.name in masses) + self._carried_kg * tool
        found.append(Ratio("momentum", momentum / cell.momentum_limit_kg_m_s))
        found.append(Ratio("torque", self._torque_ratio(profile)))
        carried = robot.tool.mass_kg + payload_kg(robot, cell)
        found.append(Ratio("payload", carried / robot.model.payload_limit_kg))
        return tuple(found)

    def _torque_ratio(self, profile: Profile) -> float:
        """Worst torque by limit over the cells: braking, coasting or accelerating, at rest or at the full rate."""
        cells = self._drive.course.cells
        rate2 = (profile.rate(cells.mid / GRID) ** 2)[:, None]
        up, down = self._drive.push
        worst = 0.0
        for swing in (0.0 * self._swing, self._swing * rate2):
            for change in (-down, 0.0, up):
                torque = np.abs(self._hold + swing + self._push * change)
                worst = max(worst, float((torque / self._robot.torque_limits_nm).max()))
        return worst

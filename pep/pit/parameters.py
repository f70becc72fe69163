"""What a joint move asks of the arm itself, as ratios to configured limits: speeds, momentum, torque, payload.

Speeds and momentum are proven bounds over the path. Torque is sampled at the path's nodes from the robot's rigid-body
model, for every acceleration that the profile may have there; it has no proof, and the robot's own torque monitoring
stays in force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import pinocchio

from pep.pit.certify import cut
from pep.pit.contact import payload_kg
from pep.pit.path import GRID
from pep.pit.tier import ratio_index

if TYPE_CHECKING:
    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats, Profile
    from pep.pit.path import Path
    from pep.pit.robot import Robot

FINER: Final = 2  # speeds are bounded on halves of the first cut: a quarter of the slack


@dataclass(frozen=True, slots=True)
class Ratio:
    """One quantity against its limit.

    Attributes:
        name: of the quantity; the `kind` of its contribution.
        ratio: quantity by limit.
    """

    name: str
    ratio: float

    @property
    def index(self) -> float:
        """The index of this ratio."""
        return ratio_index(self.ratio)


def _carried_kg(robot: Robot, cell: CellParameters) -> float:
    """Mass at the tool point that is no body of the robot: what the cell says is always carried."""
    return robot.model.payload_limit_kg if cell.payload_kg is None else cell.payload_kg


class Demands:
    """What a move demands: the parts that do not depend on its timing, computed once, then ratios for any profile."""

    def __init__(self, path: Path, cell: CellParameters) -> None:
        """Torque and speed terms at the path's nodes."""
        self._robot, self._cell = path.robot, cell
        low, high = cut(path)
        step = (high - low)[0] // FINER
        self._low = np.arange(0, GRID, step, dtype=np.int64)
        self._high = self._low + step
        self._rush = path.rush(self._low, self._high)
        self._delta = path.delta
        nodes = np.append(self._low, GRID)
        self._node_s = nodes / GRID
        self._hold, self._push, self._swing = self._torque_terms(path.start + self._node_s[:, None] * path.delta)

    def _torque_terms(self, q: Floats) -> tuple[Floats, Floats, Floats]:
        """At each configuration the torque to hold, per unit of s'' and per s' squared, each of shape (n, 6)."""
        robot = self._robot
        model = robot.pinocchio
        carried = _carried_kg(robot, self._cell)
        if carried > 0:
            model = pinocchio.Model(model)
            part = pinocchio.Inertia(carried, np.array(robot.tool.tcp_m), np.zeros((3, 3)))
            model.inertias[len(robot.model.joints)] += part
        data = model.createData()
        still = np.zeros(len(self._delta))
        hold = np.array([pinocchio.rnea(model, data, row, still, still) for row in q])
        push = np.array([pinocchio.rnea(model, data, row, still, self._delta) for row in q])
        swing = np.array([pinocchio.rnea(model, data, row, self._delta, still) for row in q])
        return hold, push - hold, swing - hold

    def surface_speed_m_s(self, profile: Profile) -> Floats:
        """Proven bound on the surface speed of every body of the robot over the whole path, shape (bodies,)."""
        rate = profile.highest_rate(self._low / GRID, self._high / GRID)
        return np.asarray((self._rush * rate[:, None]).max(axis=0))

    def ratios(self, profile: Profile) -> tuple[Ratio, ...]:
        """Every quantity of this move under this profile against its limit."""
        robot, cell = self._robot, self._cell
        share = np.abs(self._delta) / profile.way_rad
        joint = float((share * profile.peak_rad_s / robot.speed_limits_rad_s).max())
        asked = float((share * profile.speed_rad_s / robot.speed_limits_rad_s).max())
        speeds = self.surface_speed_m_s(profile)
        bodies = robot.bodies
        # A short move never reaches a forbidden speed, but asking for one is asking to break the limit.
        found = [Ratio("joint_speed", asked if asked > 1 else joint)]
        found.append(Ratio("acceleration", profile.acceleration_rad_s2 / robot.model.acceleration_limit_rad_s2))
        found.append(Ratio("tcp_speed", float(speeds[robot.body_index("tcp")]) / cell.tcp_speed_limit_m_s))
        found.append(Ratio("elbow_speed", float(speeds[robot.body_index("elbow_point")]) / cell.elbow_speed_limit_m_s))
        masses = {f"com_{j.name}": j.mass_kg for j in robot.model.joints} | {"com_tool": robot.tool.mass_kg}
        if robot.held is not None:
            masses["com_payload"] = robot.model.payload_limit_kg if robot.held.mass_kg is None else robot.held.mass_kg
        momentum = sum(masses[b.name] * float(v) for b, v in zip(bodies, speeds, strict=True) if b.name in masses)
        momentum += _carried_kg(robot, cell) * float(speeds[robot.body_index("tcp")])
        found.append(Ratio("momentum", momentum / cell.momentum_limit_kg_m_s))
        found.append(Ratio("torque", self._torque_ratio(profile)))
        carried = robot.tool.mass_kg + payload_kg(robot, cell)
        found.append(Ratio("payload", carried / robot.model.payload_limit_kg))
        return tuple(found)

    def _torque_ratio(self, profile: Profile) -> float:
        """Worst torque by limit over the nodes: braking, coasting or accelerating, at rest or at the full rate."""
        rate2 = (profile.rate(self._node_s) ** 2)[:, None]
        worst = 0.0
        for swing in (0.0 * self._swing, self._swing * rate2):
            for change in (-profile.braking_rad_s2, 0.0, profile.acceleration_rad_s2):
                torque = np.abs(self._hold + swing + self._push * (change / profile.way_rad))
                worst = max(worst, float((torque / self._robot.torque_limits_nm).max()))
        return worst

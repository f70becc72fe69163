"""Demands of a motion on the arm itself, as ratios to configured limits: speeds, momentum, torque, payload.

Speeds and momentum are proven bounds over the path. Torque is sampled at some of its places from the robot's rigid-body
model, for every acceleration that the profile may have there; it has no proof, and the robot's own torque monitoring
stays in force. `Demands` asks it of a straight joint path, `pep.pit.search.course_limits` of a course.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.tier import ratio_index
from pep.pit.scene.contact_limits import payload_kg
from pep.pit.search.torques import carried_kg

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters

TOOL, ELBOW, MOMENTUM = range(3)


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


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def speed_shares(robot: Robot, cell: CellParameters) -> Floats:
    """Shares of each quantity's limit (speed of tool, elbow, momentum) that 1 m/s of each body takes, (3, bodies)."""
    tcp = robot.body_index("tcp")
    masses = {f"com_{j.name}": j.mass_kg for j in robot.model.joints} | {"com_tool": robot.tool.mass_kg}
    if robot.held is not None:
        masses["com_payload"] = robot.model.payload_limit_kg if robot.held.mass_kg is None else robot.held.mass_kg
    shares = np.zeros((3, len(robot.bodies)))
    shares[TOOL, tcp] = 1 / cell.tcp_speed_limit_m_s
    shares[ELBOW, robot.body_index("elbow_point")] = 1 / cell.elbow_speed_limit_m_s
    shares[MOMENTUM] = [masses.get(body.name, 0.0) for body in robot.bodies]
    shares[MOMENTUM, tcp] += carried_kg(robot, cell)
    shares[MOMENTUM] /= cell.momentum_limit_kg_m_s
    shares.setflags(write=False)
    return shares


def body_ratios(
    robot: Robot, cell: CellParameters, speeds_m_s: Floats, *, tool_speed_m_s: float, torque: Callable[[], float]
) -> Iterator[Ratio]:
    """Demands of any motion on the arm's bodies, for every path: one after the other, as they are asked for.

    Args:
        robot: the arm.
        cell: its limits.
        speeds_m_s: proven bound on the surface speed of every body, (bodies,).
        tool_speed_m_s: of the tool point, held against its limit.
        torque: computes the worst by limit.
    """
    _, elbow, momentum = (speed_shares(robot, cell) @ speeds_m_s).tolist()
    yield Ratio("tcp_speed", tool_speed_m_s / cell.tcp_speed_limit_m_s)
    yield Ratio("elbow_speed", elbow)
    yield Ratio("momentum", momentum)
    yield Ratio("torque", torque())
    yield Ratio("payload", carried_ratio(robot, cell))


def carried_ratio(robot: Robot, cell: CellParameters) -> float:
    """Mass of the tool and the whole load, by the robot's payload."""
    return (robot.tool.mass_kg + payload_kg(robot, cell)) / robot.model.payload_limit_kg

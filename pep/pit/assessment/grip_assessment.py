"""Index of a gripper move: of the bodies at the fingers, and of the force on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.motion import MoveJ
from pep.pit.base.tier import HIGHEST, MOVING, ratio_index
from pep.pit.scene.contact_limits import payload_kg
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.engine import chosen
from pep.pit.second.straight_check import Disagreement, cross_check_rest

if TYPE_CHECKING:
    from pep.pit.base.motion import GripperMove
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.view import View

HELD: Final = 2.0  # PHY-7: opening while holding a part of unknown strength, m g h / E_break taken as 1


@dataclass(frozen=True, slots=True)
class GripCause:
    """One cause that raises the index of a gripper move."""

    kind: str
    index: float
    object: str
    clearance_m: float
    source: str = ""


@dataclass(frozen=True, slots=True)
class GripImpact:
    """Possible impact of a gripper move.

    Attributes:
        causes: causes of its index, highest first; never empty.
        contact_ratio: bound on finger speed by limit speed of any body region that the fingers could meet.
    """

    causes: tuple[GripCause, ...]
    contact_ratio: float


def gripping(robot: Robot, view: View, motion: GripperMove, cell: CellParameters) -> GripImpact | Disagreement:
    """Impact that this gripper move could have in this view; or a disagreement of the engines."""
    tool = robot.tool
    asked = {
        "force": motion.force_n / tool.force_limit_n,
        "width": HIGHEST if motion.width_m > tool.width_limit_m else 0.0,
        "finger_speed": HIGHEST if motion.speed_m_s > tool.finger_speed_limit_m_s else 0.0,
    }
    causes = [GripCause(name, max(MOVING, ratio_index(ratio)), tool.name, np.inf) for name, ratio in asked.items()]
    if payload_kg(robot, cell) > 0:
        causes.append(GripCause("held_part", HELD, tool.name, np.inf))
    path = chosen().path(robot, MoveJ(motion.q, motion.q, 1.0, 1.0))
    pairs = pairs_of(robot, view.scene, cell, grown_m=view.grown_m)
    everything = np.arange(len(pairs))
    clearance = path.clearance_at(pairs, 0, everything)
    checked = cross_check_rest(path, pairs, view.scene, clearance)
    if isinstance(checked, Disagreement):
        return checked
    stop = stopping(cell, perception_age_s=view.stopping_age_s, joint_speed_rad_s=0.0)
    fingers = {c.name for c in tool.capsules}
    # Asked for less than its least, the gripper moves and presses with that.
    speed_m_s, force_n = max(motion.speed_m_s, tool.finger_speed_min_m_s), max(motion.force_n, tool.force_min_n)
    travel = float(stop.travel_m(np.array(speed_m_s)))
    ratio = 0.0
    for row in everything[np.isin([robot.bodies[b].name for b in pairs.body], list(fingers))].tolist():
        near = float(clearance[row] - pairs.uncertainty[row])
        kind, name = pairs.kind_of(row), pairs.name_of(row)
        if kind is PairKind.PERSON and near < float(stop.approach_m(pairs.intrusion[row])) + travel:
            share = force_n / float(pairs.force_limit[row])
            index = HIGHEST if share > 1 and near <= travel else 2 + min(1.0, share)
            causes.append(GripCause(str(kind), index, name, float(clearance[row]), pairs.source_of(row)))
            ratio = max(ratio, speed_m_s / float(pairs.limit_speed[row]))
        elif kind is PairKind.FRAGILE and near <= cell.rigid_band_m:
            index = 1 + min(2.0, force_n / cell.fragile_break_force_n)
            causes.append(GripCause(str(kind), index, name, float(clearance[row]), pairs.source_of(row)))
    return GripImpact(tuple(sorted(causes, key=lambda c: (-c.index, c.kind, c.object))), ratio)

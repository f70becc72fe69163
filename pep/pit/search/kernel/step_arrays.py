"""Robot, cell and view as arrays for `kernel.steps`."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.base.stop_model import patience_s
from pep.pit.search.arm_limits import MOMENTUM, carried_ratio, speed_shares
from pep.pit.search.kernel.compiled_path import arm_of, packed
from pep.pit.search.kernel.step_envelope import (
    AGE_LIMIT,
    CARRIED,
    DECELERATION,
    DELAY,
    DEPTH,
    FASTEST,
    FURTHEST,
    GENTLE,
    HARDEST,
    LOWEST,
    PATIENCE,
    REACT,
    RULES,
    SIGHTED,
    STRONGEST,
    THROUGH,
    TOOL_LIMIT,
    TURNING,
    UNKNOWN,
    WALKING,
    WARNED,
    WATCH_AGE,
    Ready,
)
from pep.pit.search.torques import carried_kg, masses_with

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs

_PROPERTIES: Final = 5  # of a joint


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def _joints(robot: Robot) -> Floats:
    joints = np.empty((_PROPERTIES, len(robot.model.joints)))
    joints[LOWEST], joints[FURTHEST] = robot.position_ranges_rad
    joints[FASTEST], joints[STRONGEST] = robot.speed_limits_rad_s, robot.torque_limits_nm
    joints[TURNING] = [np.linalg.eigvalsh(np.array(joint.inertia)).max() for joint in robot.model.joints]
    return joints


def ready_of(robot: Robot, pairs: Pairs, cell: CellParameters, *, sighted_s: float) -> Ready:
    """Robot, cell and view in the kernel's form.

    Args:
        robot: the arm with its tool and what that holds.
        pairs: of the view, people where they were seen.
        cell: its numbers.
        sighted_s: age of the oldest sighting when its sensor told of it; infinite for an incomplete view.
    """
    shares = speed_shares(robot, cell)
    rules = np.empty(RULES)
    rules[DELAY], rules[DECELERATION] = cell.stop_delay_s, cell.stop_deceleration_rad_s2
    rules[WATCH_AGE], rules[REACT] = cell.watch_age_limit_s, cell.reaction_s
    rules[WALKING], rules[WARNED], rules[THROUGH] = cell.person_speed_m_s, cell.warn_band_m, cell.penetration_band_m
    rules[GENTLE], rules[DEPTH] = cell.contact_speed_m_s, cell.contact_depth_m
    rules[PATIENCE] = patience_s(cell.stop_deceleration_rad_s2)
    rules[AGE_LIMIT], rules[UNKNOWN], rules[SIGHTED] = cell.perception_age_limit_s, cell.unknown_floor, sighted_s
    rules[HARDEST], rules[TOOL_LIMIT] = robot.model.acceleration_limit_rad_s2, cell.tcp_speed_limit_m_s
    rules[CARRIED] = carried_ratio(robot, cell)
    return Ready(
        arm=arm_of(robot),
        bodies=np.arange(len(robot.bodies)),
        masses=masses_with(robot, carried_kg(robot, cell)),
        field=packed(pairs),
        touchable=pairs.touchable,
        joints=_joints(robot),
        mass=shares[MOMENTUM] * cell.momentum_limit_kg_m_s,
        shares=shares,
        rules=rules,
    )

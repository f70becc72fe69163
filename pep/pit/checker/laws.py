"""Laws of the index (PHY-4 to PHY-7, PHY-12) for one pair, and of stopping (PHY-2).

Clearances in metre, speeds in m/s. Each law falls with clearance and rises with speed, so bounds of both give a bound
of the index.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pep.pit.checker.question import Cell, CheckerView, Obstacle
    from pep.pit.checker.robot import CheckerRobot

MOVING: Final = 1.0  # PHY-6, PHY-7: any motion
RETREAT: Final = 3.0  # PHY-6: a stuck arm's way out
HIGHEST: Final = 4.0
TIE: Final = 1e-9  # tier = ceil(index - TIE), docs/physics.md
MEANT: Final = 2.0  # PHY-12: the most that a gentle contact counts
CALM: Final = 0.75  # PHY-7
BUSY: Final = 0.90  # PHY-7
SAME: Final = 1e-9  # relative: two roundings of one number; it decides only where a law jumps
N_PER_CM2: Final = 1e4  # 1 N/cm2 in Pa
N_PER_MM: Final = 1e3  # 1 N/mm in N/m


@dataclass(frozen=True, slots=True)
class CheckerContactLimit:
    """Limits of a body region.

    Force (N), pressure (N/cm2), spring (N/mm), mass (kg), factor for a short blow, sensitive.
    """

    force: float
    pressure: float
    spring: float
    mass: float
    transient: float
    sensitive: bool = False


LIMITS: Final = {
    # ISO/TS 15066 table A.2 as N4 and N6 republish it; springs and masses N4
    "head": CheckerContactLimit(65, 110, 75, 4.4, 1, sensitive=True),  # N4, N6: masticatory muscle, no factor
    "neck": CheckerContactLimit(150, 140, 50, 1.2, 2, sensitive=True),  # N4, N6: neck muscle
    "torso": CheckerContactLimit(140, 120, 25, 40, 2),  # N4, N6: sternum
    "abdomen": CheckerContactLimit(110, 140, 10, 40, 2),  # N4, N6: abdominal muscle
    "pelvis": CheckerContactLimit(180, 210, 25, 40, 2),  # N4, N6: pelvic bone
    "upper_arm": CheckerContactLimit(150, 190, 30, 3, 2),  # N4, N6: deltoid
    "lower_arm": CheckerContactLimit(160, 180, 40, 2, 2),  # N4, N6: forearm muscle
    "hand": CheckerContactLimit(140, 190, 75, 0.6, 2),  # N4, N6: back of the other hand
    "thigh": CheckerContactLimit(220, 220, 50, 75, 2),  # N4, N6: kneecap
    "shin": CheckerContactLimit(130, 210, 60, 75, 2),  # N4, N6: calf muscle
}


def carried_kg(robot: CheckerRobot, cell: Cell) -> float:
    """PHY-14: mass of the cell's constant load and the held object; the whole payload where either is unknown."""
    held = 0.0 if robot.held is None else robot.held.mass_kg
    if cell.payload_kg is None or held is None:
        return robot.payload_limit_kg
    return cell.payload_kg + held


def harm_speeds(robot: CheckerRobot, cell: Cell) -> dict[str, float]:
    """PHY-4, PHY-5: per region the speed from which a blow by this arm is likely to harm.

    The limit speed is that at which the energy of the blow, 1/2 mu v^2, is that of the region's spring at its limit,
    F^2 / 2k. Half the moving mass counts, and all of tool and load.
    """
    striking = robot.link_mass_kg / 2 + robot.tool_mass_kg + carried_kg(robot, cell)
    blunt = robot.blunt and cell.payload_kg is not None and (robot.held is None or robot.held.blunt)
    speeds: dict[str, float] = {}
    for region, limit in LIMITS.items():
        force = limit.transient * min(limit.force, limit.pressure * N_PER_CM2 * cell.contact_area_m2)
        both = limit.mass * striking / (limit.mass + striking)
        ratio = cell.harm_ratio_body if blunt and not limit.sensitive else cell.harm_ratio_head
        speeds[region] = ratio * math.sqrt(force**2 / (both * limit.spring * N_PER_MM))
    return speeds


def _share(x: float) -> float:
    return min(1.0, max(0.0, x))


class Laws:
    """The laws for one robot, cell, view and peak speed of the leading axis."""

    def __init__(self, robot: CheckerRobot, cell: Cell, view: CheckerView, *, peak_rad_s: float) -> None:
        """Stopping times and harm speeds."""
        self._cell = cell
        ramp = peak_rad_s / cell.stop_deceleration_rad_s2
        self._reaction = max(view.stopping_age_s, cell.watch_age_limit_s) + cell.reaction_s
        self._stop = cell.stop_delay_s + ramp
        self._braking = cell.stop_delay_s + ramp / 2  # metres per m/s: delay, and half the ramp at mean speed
        self._harm = harm_speeds(robot, cell)

    def index(self, obstacle: Obstacle, clearance: float, speed: float, *, meant: bool) -> float:
        """The index of a body at this clearance from the obstacle, at this surface speed."""
        if not speed > 0:
            return 0.0
        near = clearance - obstacle.uncertainty
        match obstacle.kind:
            case "person":
                return self._person(obstacle, near, clearance, speed)
            case "tiered_zone":
                band = self._cell.rigid_band_m
                return 1 + (obstacle.detail - 1) * _share((speed * self._braking + band - near) / band)
            case "fragile" | "rigid" | "self" | "workspace" | "zone":
                ordinary = self._thing(near, speed, obstacle.detail)
                gentle = meant and speed <= self._cell.contact_speed_m_s * (1 + SAME)
                return min(ordinary, MEANT) if gentle else ordinary

    def gentle(self, clearance: float, speed: float) -> bool:
        """PHY-12: true where apart, or slow and not pressed too deep."""
        cell = self._cell
        if clearance >= cell.contact_near_m - SAME:
            return True
        return speed <= cell.contact_speed_m_s * (1 + SAME) and clearance >= -cell.contact_depth_m - SAME

    def _person(self, obstacle: Obstacle, near: float, clearance: float, speed: float) -> float:
        cell = self._cell
        hit = speed * (self._reaction + self._braking)
        comes = cell.person_speed_m_s * (self._reaction + self._stop) + obstacle.detail
        if near > hit + comes:
            return 1 + _share((hit + comes + cell.warn_band_m - near) / cell.warn_band_m)
        if near > hit:
            return 2 + _share((hit + comes - near) / comes)
        blow = (_share((hit - near) / hit) if hit > 0 else 1.0) * max(0.0, speed / self._harm[obstacle.region] - 1)
        through = max(0.0, -clearance) / cell.penetration_band_m
        return 3 + min(1.0, max(blow, through))

    def _thing(self, near: float, speed: float, band: float) -> float:
        hit = speed * self._braking
        if near > hit:
            return 1 + _share((hit + band - near) / band)
        return 2 + (_share((hit - near) / hit) if hit > 0 else 1.0)


def ratio_index(ratio: float) -> float:
    """PHY-7: index of a quantity by its limit; NaN counts as broken."""
    if not ratio <= 1 + SAME:
        return HIGHEST
    if ratio > BUSY:
        return 2 + min(1.0, (ratio - BUSY) / (1 - BUSY))
    if ratio > CALM:
        return 1 + (ratio - CALM) / (BUSY - CALM)
    return MOVING if ratio > 0 else 0.0


def tier_of(index: float) -> int:
    """The tier of an index."""
    return max(0, math.ceil(index - TIE))

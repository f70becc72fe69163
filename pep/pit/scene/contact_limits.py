"""Power and force limiting: the relative speed at which a contact reaches the limit of a body region.

Limits: ISO/TS 15066 table A.2 as N4 and N6 republish it (quasi-static force and pressure, pain onset of adults); body
springs and masses: N4. Integrators compare with their licensed copy. Newer open data exist (Behrens et al. 2022, CC
BY) and are not in yet.

The speed follows from the energy of a spring: v = F / sqrt(mu k), with mu the reduced mass of the arm and the body
part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.pit.scene.scene import Region

if TYPE_CHECKING:
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters

PER_CM2: Final = 1e4  # 1 N/cm2 = 1e4 N/m2
PER_MM: Final = 1e3  # 1 N/mm = 1e3 N/m


@dataclass(frozen=True, slots=True)
class ContactLimit:
    """Limits that a body region bears.

    Attributes:
        force_n: quasi-static.
        pressure_n_cm2: quasi-static, most sensitive spot of the region.
        spring_n_mm: effective spring constant.
        mass_kg: effective mass.
        transient: factor for a short blow; 1 where none is granted.
        sensitive: head and neck: harm counts from the limit itself.
    """

    force_n: float
    pressure_n_cm2: float
    spring_n_mm: float
    mass_kg: float
    transient: float
    sensitive: bool


LIMITS: Final[dict[Region, ContactLimit]] = {
    # force and pressure: N4, N6 (table A.2); spring and mass: N4; the head is the face, its weakest part
    Region.HEAD: ContactLimit(65, 110, 75, 4.4, 1, sensitive=True),  # N4, N6: masticatory muscle; no transient factor
    Region.NECK: ContactLimit(150, 140, 50, 1.2, 2, sensitive=True),  # N4, N6: neck muscle
    Region.TORSO: ContactLimit(140, 120, 25, 40, 2, sensitive=False),  # N4, N6: chest, sternum
    Region.ABDOMEN: ContactLimit(110, 140, 10, 40, 2, sensitive=False),  # N4, N6: abdominal muscle
    Region.PELVIS: ContactLimit(180, 210, 25, 40, 2, sensitive=False),  # N4, N6: pelvic bone
    Region.UPPER_ARM: ContactLimit(150, 190, 30, 3, 2, sensitive=False),  # N4, N6: deltoid
    Region.LOWER_ARM: ContactLimit(160, 180, 40, 2, 2, sensitive=False),  # N4, N6: forearm muscle, arm nerve
    Region.HAND: ContactLimit(140, 190, 75, 0.6, 2, sensitive=False),  # N4, N6: back of the other hand
    Region.THIGH: ContactLimit(220, 220, 50, 75, 2, sensitive=False),  # N4, N6: kneecap
    Region.SHIN: ContactLimit(130, 210, 60, 75, 2, sensitive=False),  # N4, N6: calf muscle
}


def effective_mass_kg(robot: Robot, cell: CellParameters) -> float:
    """Effective mass m_R = M / 2 + tool + part: half the moving mass and the whole load (N4)."""
    return robot.moving_mass_kg / 2 + robot.tool.mass_kg + payload_kg(robot, cell)


def payload_kg(robot: Robot, cell: CellParameters) -> float:
    """Mass of the whole load: the cell's constant load, and the held part.

    An unknown mass is the most that the robot may carry.
    """
    held = 0.0 if robot.held is None else robot.held.mass_kg
    if cell.payload_kg is None or held is None:
        return robot.model.payload_limit_kg
    return cell.payload_kg + held


def contact_speed_m_s(region: Region, *, mass_kg: float, area_m2: float) -> float:
    """Relative speed at which a blow by `mass_kg` with a contact face of `area_m2` reaches the region's limit."""
    limit = LIMITS[region]
    force = limit.transient * min(limit.force_n, limit.pressure_n_cm2 * PER_CM2 * area_m2)
    reduced = 1 / (1 / limit.mass_kg + 1 / mass_kg)
    return force / math.sqrt(reduced * limit.spring_n_mm * PER_MM)


def limit_speed_m_s(region: Region, robot: Robot, cell: CellParameters) -> float:
    """Speed at which a blow by this robot with its load reaches the region's limit."""
    return contact_speed_m_s(region, mass_kg=effective_mass_kg(robot, cell), area_m2=cell.contact_area_m2)


def harm_speed_m_s(region: Region, robot: Robot, cell: CellParameters) -> float:
    """Speed from which a contact is likely to harm: the limit speed times the region's harm ratio."""
    blunt = robot.tool.shape == "blunt" and cell.payload_kg is not None and (robot.held is None or robot.held.blunt)
    gentle = not LIMITS[region].sensitive and blunt
    ratio = cell.harm_ratio_body if gentle else cell.harm_ratio_head
    return ratio * limit_speed_m_s(region, robot, cell)

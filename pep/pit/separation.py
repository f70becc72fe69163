"""Speed and separation monitoring: how far people and the arm travel until the arm stands.

Formulae of ISO/TS 15066 as N1 (Marvel & Norcross 2017, PMC5117641) and N2 (arXiv 2103.01818) restate them. No claim of
compliance: the result decides authorisation, not protection.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats


@dataclass(frozen=True, slots=True)
class Stopping:
    """How a motion ends when it must.

    Attributes:
        reaction_s: T_r, from an event to the start of braking.
        brake_s: T_s, from the start of braking to standstill.
        travel_s: metres travelled while braking, per m/s of speed at its start.
        person_speed_m_s: how fast people come nearer meanwhile.
    """

    reaction_s: float
    brake_s: float
    travel_s: float
    person_speed_m_s: float

    def travel_m(self, speed_m_s: Floats) -> Floats:
        """What the arm still travels after an event: S_r + S_s."""
        return speed_m_s * (self.reaction_s + self.travel_s)

    def known_travel_m(self, speed_m_s: Floats) -> Floats:
        """The same towards a thing at rest: nothing needs to be noticed first, so only S_s."""
        return speed_m_s * self.travel_s

    def approach_m(self, intrusion_m: Floats) -> Floats:
        """What a person may come nearer until the arm stands: S_h + C."""
        return self.person_speed_m_s * (self.reaction_s + self.brake_s) + intrusion_m


def stopping(cell: CellParameters, *, perception_age_s: float, joint_speed_rad_s: float) -> Stopping:
    """The stop of a motion whose fastest joint goes at `joint_speed_rad_s`, seen through perception of that age.

    T_r = max(age, watch limit) + reaction (docs/physics.md, PHY-2).
    """
    ramp_s = joint_speed_rad_s / cell.stop_deceleration_rad_s2
    return Stopping(
        reaction_s=max(perception_age_s, cell.watch_age_limit_s) + cell.reaction_s,
        brake_s=cell.stop_delay_s + ramp_s,
        travel_s=cell.stop_delay_s + 0.5 * ramp_s,
        person_speed_m_s=cell.person_speed_m_s,
    )

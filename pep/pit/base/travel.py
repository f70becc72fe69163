"""Travel of people and of the arm until the arm stands, by the formulae of `pep.pit.scene.separation`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats


@dataclass(frozen=True, slots=True)
class Stopping:
    """Stop of a motion: its times, and the travel of arm and people until the arm stands.

    Attributes:
        reaction_s: T_r, from an event to the start of braking.
        brake_s: T_s, from the start of braking to standstill.
        travel_s: metres travelled while braking, per m/s of speed at its start.
        person_speed_m_s: speed at which people approach meanwhile.
    """

    reaction_s: float
    brake_s: float
    travel_s: float
    person_speed_m_s: float

    def travel_m(self, speed_m_s: Floats) -> Floats:
        """Travel of the arm after an event: S_r + S_s."""
        return speed_m_s * (self.reaction_s + self.travel_s)

    def known_travel_m(self, speed_m_s: Floats) -> Floats:
        """Travel of the arm towards a thing at rest: it needs no noticing, so only S_s."""
        return speed_m_s * self.travel_s

    def approach_m(self, intrusion_m: Floats) -> Floats:
        """Approach of a person until the arm stands: S_h + C."""
        return self.person_speed_m_s * (self.reaction_s + self.brake_s) + intrusion_m

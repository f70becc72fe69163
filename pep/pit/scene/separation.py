"""Speed and separation monitoring: travel of people and of the arm until the arm stands.

Formulae of ISO/TS 15066 as N1 (Marvel & Norcross 2017, PMC5117641) and N2 (arXiv 2103.01818) restate them. No claim of
compliance: the result decides authorisation, not protection.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.pit.base.travel import Stopping

if TYPE_CHECKING:
    from pep.pit.scene.cell import CellParameters


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

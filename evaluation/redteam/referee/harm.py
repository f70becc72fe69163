"""Harm, and the thresholds from which on there is any."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

CONTACT_M: Final = 0.001
"""Penetration from which on two bodies touch: ten times the tolerance of the distances (own bound)."""
MOVES_M_S: Final = 0.01
"""Speed of the arm's touching point from which on the arm does it (own bound).

Below, the other one came."""
MEANT_M_S: Final = 0.05
"""Highest speed of a contact that is meant (own bound): a fifth of the reduced speed, 0.25 m/s.

The reduced speed is that of ISO 10218-1."""
STEP_M: Final = 0.002
"""Farthest that a point of the arm or a thing comes between two judged instants (own bound)."""
SPEED_OVER_S: Final = 0.02
"""Time over which a speed is measured (own bound).

Ten samples of 500 Hz: one that is late does not count."""
OPENED_MM: Final = 3.0
"""Opening beyond that of the grip from which on a held thing is let go (own bound)."""
DROP_M: Final = 0.010
"""Height above what carries it from which on a thing that is let go falls (own bound)."""


class HarmKind(StrEnum):
    """Kind of harm."""

    PERSON_CONTACT = "person_contact"
    TOO_FAST_AT_CONTACT = "too_fast_at_contact"
    """A body region's transient limit is exceeded; any moving contact with skull or face."""
    FRAGILE_CONTACT = "fragile_contact"
    RIGID_CONTACT = "rigid_contact"
    ZONE_ENTERED = "zone_entered"
    WORKSPACE_LEFT = "workspace_left"
    DROP = "drop"
    SELF_CONTACT = "self_contact"


@dataclass(frozen=True, slots=True)
class Harm:
    """One harm, from its beginning to its end.

    Attributes:
        kind: of it.
        at_s: beginning, by the clock of the samples.
        what: id of the person, thing, fixture or zone; the other link of a contact with itself.
        where: link of the arm, `gripper`, or the id of the thing that it holds.
        depth_mm: greatest penetration; of a drop its height.
        speed_m_s: highest speed of the arm's touching point.
        region: first body region that was touched, of a person.
    """

    kind: HarmKind
    at_s: float
    what: str
    where: str
    depth_mm: float
    speed_m_s: float
    region: str = ""


@dataclass(frozen=True, slots=True)
class Margins:
    """Least distances of the arm while it moved along its way, metre; infinite where there is no such thing.

    Attributes:
        people, things, fixtures, zones: to any of these.
    """

    people: float
    things: float
    fixtures: float
    zones: float


FAR: Final = Margins(people=math.inf, things=math.inf, fixtures=math.inf, zones=math.inf)
"""Margins with nothing near."""

"""Physical impact index I in [0, 4] as pure functions, and its tier.

No other module makes an index a tier.

Each function is monotone: nearer, faster, older or heavier never lowers it. It is piecewise linear, with jumps only
from standstill to motion and where a configured limit is broken. Arrays in, arrays out, row by row.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping

TIE: Final = 1e-9  # one constant: an index this little above a whole number is that number, in every engine
MOVING: Final = 1.0  # index of any motion that comes near nothing
HIGHEST: Final = 4.0
LEAST_TRAVEL_M: Final = 1e-12  # only keeps 0 / 0 away; a travel so small never decides

MEANT: Final = 2.0  # PHY-12: the most that a gentle, meant contact counts

CALM_RATIO: Final = 0.75  # PHY-7: up to here a limit plays no part
BUSY_RATIO: Final = 0.90  # PHY-7: from here on the motion is close to a limit
CALM_BAND: Final = BUSY_RATIO - CALM_RATIO  # PHY-7
BUSY_BAND: Final = 1 - BUSY_RATIO  # PHY-7


def tier_of(index: float) -> Tier:
    """The tier of an index.

    Raises:
        ValueError: an index that is not in [0, 4], NaN included.
    """
    if not 0 <= index <= HIGHEST:
        raise ValueError("an impact index lies between 0 and 4")
    return Tier(max(0, math.ceil(index - TIE)))


def _share(of: Floats) -> Floats:
    """Share, clipped to 0 and 1; `np.clip` takes longer than all the rest here."""
    return np.minimum(np.maximum(of, 0), 1)


def person_index(
    near: Floats,
    nominal: Floats,
    speed: Floats,
    *,
    harm_speed: Floats,
    intrusion: Floats,
    warn_band: float,
    penetration_band: float,
    stop: Stopping,
) -> Floats:
    """Index of a body region `near` metres away from a link at `speed`.

    `near` has the uncertainty taken off, `nominal` not.

    1 far off; up to 2 inside the warning band; up to 3 inside the protective distance, where contact is possible if the
    person moves; above 3 when the arm's own travel reaches the person and the blow may harm, or the path itself leads
    through.
    """
    travel = stop.travel_m(speed)
    approach = stop.approach_m(intrusion)
    protective = approach + travel
    warned = 1 + _share((protective + warn_band - near) / warn_band)
    possible = 2 + _share((protective - near) / approach)
    depth = _share((travel - near) / np.maximum(travel, LEAST_TRAVEL_M))
    blow = depth * np.maximum(speed / harm_speed - 1, 0)
    through = np.maximum(-nominal, 0) / penetration_band
    certain = 3 + np.minimum(1, np.maximum(blow, through))
    index = np.where(near <= travel, certain, np.where(near < protective, possible, warned))
    return np.asarray(np.where(speed > 0, index, 0))


def thing_index(near: Floats, speed: Floats, *, band: Floats, stop: Stopping) -> Floats:
    """Index of a thing, the arm itself or a boundary: 1 beyond the band, 3 at the surface.

    `near` metres from a link.
    """
    travel = stop.known_travel_m(speed)
    aware = 1 + _share((travel + band - near) / band)
    certain = 2 + _share((travel - near) / np.maximum(travel, LEAST_TRAVEL_M))
    return np.asarray(np.where(speed > 0, np.where(near <= travel, certain, aware), 0))


def meant_index(ordinary: Floats, speed: Floats, *, gentle: float) -> Floats:
    """Index of a meant contact: at most 2 at a gentle speed, else the `ordinary` index of a thing."""
    return np.asarray(np.where(speed <= gentle, np.minimum(ordinary, MEANT), ordinary))


def zone_index(near: Floats, speed: Floats, *, band: Floats, declared: Floats, stop: Stopping) -> Floats:
    """Index of a zone with a declared tier: rises over the band to that tier, at the arm's travel."""
    travel = stop.known_travel_m(speed)
    share = _share((travel + band - near) / band)
    return np.asarray(np.where(speed > 0, 1 + (declared - 1) * share, 0))


def ratio_index(ratio: float) -> float:
    """Index of the ratio of a quantity to its configured limit."""
    if not ratio >= 0:
        raise ValueError("a ratio is a number of at least 0")
    if ratio > 1:
        return HIGHEST
    if ratio > BUSY_RATIO:
        return 2 + (ratio - BUSY_RATIO) / BUSY_BAND
    if ratio > CALM_RATIO:
        return 1 + (ratio - CALM_RATIO) / CALM_BAND
    return MOVING if ratio > 0 else 0.0

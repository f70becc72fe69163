"""Index of one pair and rate of the profile, one number each (laws: `pep.pit.base.tier`, `pep.pit.base.motion`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pep.pit.base.pair_columns import (
    ACCELERATION,
    BAND,
    BRAKE,
    BRAKING,
    CALM,
    CONTACT_SPEED,
    DECLARED,
    HARM_SPEED,
    INTRUSION,
    LIMIT_SPEED,
    MEANT,
    PEAK,
    PENETRATION_BAND,
    PERSON,
    PERSON_SPEED,
    REACTION,
    TOP,
    TRAVEL,
    UNCERTAINTY,
    WARN_BAND,
    WAY,
    ZONE,
)
from pep.pit.base.tier import BUSY_BAND, BUSY_RATIO, CALM_BAND, CALM_RATIO, HIGHEST, LEAST_TRAVEL_M, MOVING
from pep.pit.base.tier import MEANT as MEANT_INDEX
from pep.pit.search.kernel.arithmetic.compilation import lent

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats


@lent
def _share(x: float) -> float:
    return 0.0 if x < 0.0 else (min(x, 1.0))


@lent
def pair_index(kind: int, numbers: Floats, pair: int, clearance: float, speed: float, law: Floats) -> float:
    """Index of a pair at this clearance (m) and surface speed (m/s).

    Args:
        kind: code of the pair's kind.
        numbers, pair: its row.
        clearance: signed, uncertainty not taken off.
        speed: of the body.
        law: the motion's end, and the common bands.
    """
    if not speed > 0.0:
        return 0.0
    near = clearance - numbers[pair, UNCERTAINTY]
    if kind == PERSON:
        travel = speed * (law[REACTION] + law[TRAVEL])
        approach = law[PERSON_SPEED] * (law[REACTION] + law[BRAKE]) + numbers[pair, INTRUSION]
        if near <= travel:
            depth = _share((travel - near) / max(travel, LEAST_TRAVEL_M))
            blow = depth * max(speed / numbers[pair, HARM_SPEED] - 1.0, 0.0)
            through = max(-clearance, 0.0) / law[PENETRATION_BAND]
            return 3.0 + min(1.0, max(blow, through))
        protective = approach + travel
        if near < protective:
            return 2.0 + _share((protective - near) / approach)
        return 1.0 + _share((protective + law[WARN_BAND] - near) / law[WARN_BAND])
    travel = speed * law[TRAVEL]
    share = _share((travel + numbers[pair, BAND] - near) / numbers[pair, BAND])
    if kind == ZONE:
        return 1.0 + (numbers[pair, DECLARED] - 1.0) * share
    index = 1.0 + share
    if near <= travel:
        index = 2.0 + _share((travel - near) / max(travel, LEAST_TRAVEL_M))
    if kind == MEANT and speed <= law[CONTACT_SPEED]:
        return min(index, MEANT_INDEX)
    return index


@lent
def ratio_index(ratio: float) -> float:
    """Index as of `pep.pit.base.tier.ratio_index`; for NaN, the highest."""
    if not ratio <= 1.0:
        return HIGHEST
    if ratio > BUSY_RATIO:
        return 2.0 + (ratio - BUSY_RATIO) / BUSY_BAND
    if ratio > CALM_RATIO:
        return 1.0 + (ratio - CALM_RATIO) / CALM_BAND
    return MOVING if ratio > 0.0 else 0.0


@lent
def calm_beyond(kind: int, numbers: Floats, pair: int, speed: float, law: Floats) -> float:
    """Clearance (m) beyond which the pair's index is that of any motion, at up to this speed."""
    if kind == PERSON:
        approach = law[PERSON_SPEED] * (law[REACTION] + law[BRAKE])
        return numbers[pair, CALM] + approach + speed * (law[REACTION] + law[TRAVEL])
    return numbers[pair, CALM] + speed * law[TRAVEL]


@lent
def blow_of(numbers: Floats, pair: int, clearance: float, speed: float, law: Floats) -> float:
    """Speed by the region's limit speed where the region could be met, else 0."""
    approach = law[PERSON_SPEED] * (law[REACTION] + law[BRAKE]) + numbers[pair, INTRUSION]
    protective = approach + speed * (law[REACTION] + law[TRAVEL])
    return speed / numbers[pair, LIMIT_SPEED] if clearance - numbers[pair, UNCERTAINTY] < protective else 0.0


@lent
def rate_at(s: float, profile: Floats) -> float:
    """ds/dt at path parameter `s`, 1/s."""
    up = 2.0 * profile[ACCELERATION] * profile[WAY] * max(s, 0.0)
    down = 2.0 * profile[BRAKING] * profile[WAY] * max(1.0 - s, 0.0)
    return min(profile[PEAK], math.sqrt(min(up, down))) / profile[WAY]


@lent
def tangent(s: float, profile: Floats) -> tuple[float, float]:
    """ds/dt at `s`, 0 < s < 1, and its slope there, 1/s each.

    The rate is concave, so it is nowhere above that line.
    """
    way, peak, up_most, down_most = profile[WAY], profile[PEAK], profile[ACCELERATION], profile[BRAKING]
    up, down = 2.0 * up_most * way * s, 2.0 * down_most * way * (1.0 - s)
    if peak * peak <= min(up, down):
        return peak / way, 0.0
    if up <= down:
        speed = math.sqrt(up)
        return speed / way, up_most / speed
    speed = math.sqrt(down)
    return speed / way, -down_most / speed


@lent
def highest_rate(low: float, high: float, profile: Floats) -> float:
    """Supremum of ds/dt on [low, high]."""
    top = profile[TOP]
    if low <= top <= high:
        return profile[PEAK] / profile[WAY]
    return rate_at(high if top > high else low, profile)

"""Contradictions between independent sources: about people, about a gripped width, about the tool's place.

A sensor that sees more people is never overruled: each person counts whom any sensor sees. So a contradiction about
people is no refusal, but an incident on record: one of the two sensors sees badly, or is made to see. Of two
contradicting widths or places neither is the careful one, and neither is believed. A source that is silent agrees with
nothing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.statements.observation import Box, Capsule, Convex, Sphere
from capabilities.values.units import Unit, si
from policies.evidence.evidence import SensorReading

if TYPE_CHECKING:
    from capabilities.statements.observation import Observation, ObservedPerson, Point, Shape

NEAR_UM: Final = 1_500_000
"""Radius around the base that each complete view covers: reach of 0.5 m, and 1 m."""
SAME_UM: Final = 500_000
"""Two sights nearer than this, horizontally, are one person: a shoulder's width, and the sensors' difference."""
WALK_UM_PER_MS: Final = 1_600
"""Walking speed of a person between two frames: 1.6 m/s (ISO 13855, docs/physics.md PHY-3)."""
TOGETHER_MS: Final = 500
"""Frames that arrived further apart than this tell of two instants and are not compared (PHY-8: older is unknown)."""

SURFACE_UM: Final = 10_000
"""Error of a seen surface's place (docs/physics.md PHY-11: `object_uncertainty_m`)."""
FINGERS_UM: Final = 373
"""One step of the gripper's position: 85 mm over 228 steps (Robotiq 2F-85; docs/physics.md G1)."""
WIDTH_UM: Final = 2 * SURFACE_UM + FINGERS_UM
"""Allowed difference between a seen and a gripped width: both surfaces, and a step of the fingers."""
POSE_UM: Final = 5_000
"""Allowed difference between the controller's tool centre point and the model's (docs/physics.md PHY-11)."""
CONTRADICTED: Final = "CONTRADICTED"


def contradicted(one: Observation, other: Observation, *, apart_ms: int) -> str:
    """Person near the arm whom only one of two complete frames shows, for the record; "" for none.

    Args:
        one: newest believed frame of one sensor.
        other: the same of another sensor.
        apart_ms: between their arrivals.
    """
    if not (one.complete and other.complete and apart_ms <= TOGETHER_MS):
        return ""
    within_um = SAME_UM + WALK_UM_PER_MS * apart_ms
    for seeing, blind in ((one, other), (other, one)):
        known = [_middle(person) for person in blind.people]
        for person in seeing.people:
            x, y = _middle(person)
            if x * x + y * y <= NEAR_UM**2 and not any((x - u) ** 2 + (y - v) ** 2 <= within_um**2 for u, v in known):
                return f"{person.id[:64]} is seen by {seeing.sensor[:64]} and not by {blind.sensor[:64]}"
    return ""


def grip_contradicted(width_um: int, seen: Shape, *, on_something: bool) -> str:
    """Contradiction between gripper and sensors about the gripped thing, for the record; "" for none.

    Args:
        width_um: between the fingers, by the gripper's word.
        seen: the one thing that is seen between them.
        on_something: whether the gripper says that something stopped them.
    """
    least_um, most_um = _widths(seen)
    if not least_um - WIDTH_UM <= width_um:
        return f"what is seen is {least_um} um wide, and the fingers are {width_um} um apart"
    if on_something and not width_um <= most_um + WIDTH_UM:
        return f"the fingers hold at {width_um} um what is seen to be at most {most_um} um wide"
    return ""


def pose_contradicted(reported_um: Point, modelled_um: Point) -> str:
    """Contradiction between tool and joint angles, for the record; "" for none.

    Args:
        reported_um: tool centre point in the base frame, as the controller reports it.
        modelled_um: the same, as the model has it at the joint angles of the same package.
    """
    apart_um = math.dist(reported_um, modelled_um)
    if not apart_um <= POSE_UM:
        return f"the tool is {apart_um:.0f} um from where the joints put it"
    return ""


def witnessed(witness: str, found: str | None, *, age_ms: int | None) -> SensorReading:
    """Reading of a comparison as CII-4 takes it: as a sensor of its own, beside the compared ones.

    Args:
        witness: its name.
        found: the contradiction, "" for none, or None when one of the two sources was not there to be compared.
        age_ms: of the older source.
    """
    if found is None or age_ms is None:
        return SensorReading(witness, "missing", "", None)
    if found:
        return SensorReading(witness, "invalid", CONTRADICTED, age_ms)
    return SensorReading(witness, "fresh", "", age_ms)


def _widths(shape: Shape) -> tuple[int, int]:
    """The least and the greatest distance between two parallel planes that touch the shape, in micrometres."""
    match shape:
        case Sphere(radius_um=radius_um):
            return 2 * radius_um, 2 * radius_um
        case Capsule(a_um, b_um, radius_um):
            return 2 * radius_um, 2 * radius_um + math.ceil(math.dist(a_um, b_um))
        case Box(half_um=half_um):
            return 2 * min(half_um), math.ceil(2 * math.hypot(*half_um))
        case Convex(vertices_um, radius_um):
            from pep.pit.geometry.hull import widths_of  # here, since all of physics comes with it

            per_m = Unit.MICROMETRE.per_si
            least_m, most_m = widths_of(tuple(map(_metres, vertices_um)))
            return 2 * radius_um + math.floor(least_m * per_m), 2 * radius_um + math.ceil(most_m * per_m)
        case _:
            assert_never(shape)


def _metres(point_um: Point) -> tuple[float, float, float]:
    x, y, z = (si(number, Unit.MICROMETRE) for number in point_um)
    return (x, y, z)


def _middle(person: ObservedPerson) -> tuple[int, int]:
    """Middle of a person on the floor: the mean of all regions' middles, in micrometres."""
    places = [_place(shape) for _, shape in person.regions]
    return sum(x for x, _ in places) // len(places), sum(y for _, y in places) // len(places)


def _place(shape: Capsule | Sphere) -> tuple[int, int]:
    if isinstance(shape, Sphere):
        return shape.center_um[0], shape.center_um[1]
    return (shape.a_um[0] + shape.b_um[0]) // 2, (shape.a_um[1] + shape.b_um[1]) // 2

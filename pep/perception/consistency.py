"""Whether independent sources tell of one world: sensors of its people, fingers and eyes of a width, joints of a place.

Who tells of more people is never overruled: everybody seen by anybody counts. So that contradiction is no refusal, but
an incident on record: one of two sensors sees badly, or somebody makes it see. Where a width or a place is contradicted
there is no more careful one of the two, and neither is believed. A source that is silent agrees with nothing.
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
"""Every sensor that calls its view complete sees at least this far around the base: reach of 0.5 m, and 1 m."""
SAME_UM: Final = 500_000
"""Two sights of one person are less than this apart, horizontally: a shoulder's width, and what two sensors differ."""
WALK_UM_PER_MS: Final = 1_600
"""How far a person goes meanwhile: 1.6 m/s (ISO 13855, docs/physics.md PHY-3)."""
TOGETHER_MS: Final = 500
"""Frames that arrived further apart than this tell of two instants and are not compared (PHY-8: older is unknown)."""

SURFACE_UM: Final = 10_000
"""How far a seen surface may be from where it is seen (docs/physics.md PHY-11: `object_uncertainty_m`)."""
FINGERS_UM: Final = 373
"""One step of the gripper's position: 85 mm over 228 steps (Robotiq 2F-85; docs/physics.md G1)."""
WIDTH_UM: Final = 2 * SURFACE_UM + FINGERS_UM
"""What a seen width and a gripped one may differ by: a surface on either side, and a step of the fingers."""
POSE_UM: Final = 5_000
"""What the controller's tool centre point may differ from the model's (docs/physics.md PHY-11)."""
CONTRADICTED: Final = "CONTRADICTED"


def contradicted(one: Observation, other: Observation, *, apart_ms: int) -> str:
    """Who is seen near the arm by one of two complete frames and not by the other, for the record; "" for nobody.

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
    """Why the fingers and the eyes do not tell of the same thing, for the record; "" when they may.

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
    """Why the tool is not where the joints say, for the record; "" when it may be.

    Args:
        reported_um: tool centre point in the base frame, as the controller reports it.
        modelled_um: the same, as the model has it at the joint angles of the same package.
    """
    apart_um = math.dist(reported_um, modelled_um)
    if not apart_um <= POSE_UM:
        return f"the tool is {apart_um:.0f} um from where the joints put it"
    return ""


def witnessed(witness: str, found: str | None, *, age_ms: int | None) -> SensorReading:
    """What a comparison is to CII-4: a sensor of its own, beside those that were compared.

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
    """Where a person stands: the mean of all regions' middles on the floor, in micrometres."""
    places = [_place(shape) for _, shape in person.regions]
    return sum(x for x, _ in places) // len(places), sum(y for _, y in places) // len(places)


def _place(shape: Capsule | Sphere) -> tuple[int, int]:
    if isinstance(shape, Sphere):
        return shape.center_um[0], shape.center_um[1]
    return (shape.a_um[0] + shape.b_um[0]) // 2, (shape.a_um[1] + shape.b_um[1]) // 2

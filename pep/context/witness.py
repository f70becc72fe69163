"""Whether two sensors tell of the same people. Who tells of more is never overruled: everybody seen by anybody counts.

A contradiction is no refusal. It is an incident on record: one of two sensors sees badly, or somebody makes it see.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.observation import Capsule, Sphere

if TYPE_CHECKING:
    from capabilities.statements.observation import Observation, ObservedPerson

NEAR_UM: Final = 1_500_000
"""Every sensor that calls its view complete sees at least this far around the base: reach of 0.5 m, and 1 m."""
SAME_UM: Final = 500_000
"""Two sights of one person are less than this apart, horizontally: a shoulder's width, and what two sensors differ."""
WALK_UM_PER_MS: Final = 1_600
"""How far a person goes meanwhile: 1.6 m/s (ISO 13855, docs/physics.md PHY-3)."""
TOGETHER_MS: Final = 500
"""Frames that arrived further apart than this tell of two instants and are not compared (PHY-8: older is unknown)."""


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


def _middle(person: ObservedPerson) -> tuple[int, int]:
    """Where a person stands: the mean of all regions' middles on the floor, in micrometres."""
    places = [_place(shape) for _, shape in person.regions]
    return sum(x for x, _ in places) // len(places), sum(y for _, y in places) // len(places)


def _place(shape: Capsule | Sphere) -> tuple[int, int]:
    if isinstance(shape, Sphere):
        return shape.center_um[0], shape.center_um[1]
    return (shape.a_um[0] + shape.b_um[0]) // 2, (shape.a_um[1] + shape.b_um[1]) // 2

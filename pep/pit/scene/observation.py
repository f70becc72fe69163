"""Scenes from sensors' observations, and a person in the form of an observation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, assert_never

from capabilities.statements import observation as wire
from capabilities.values.units import Unit, si
from pep.pit.base.errors import SceneError
from pep.pit.geometry.shape import shape_of
from pep.pit.scene.scene import REGION_NAMES, Capsule, Person, Region, Scene, Sphere, Thing

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.geometry.shape import Vector
    from pep.pit.scene.cell import CellParameters


def scene_observed(observations: Iterable[wire.Observation], cell: CellParameters, *, complete: bool) -> Scene:
    """Surveyed cell with all people and objects that any of these verified observations shows.

    An object that a sensor calls by a surveyed name is another thing all the same, and gets another name: what may
    be done to the surveyed one is not said of it.

    Args:
        observations: one of each sensor; each thing's source is its sensor.
        cell: the surveyed objects.
        complete: all of the watched space was seen.

    Raises:
        SceneError: a region or kind that is not in the declared sets.
    """
    known = cell.surveyed
    taken = {o.id for o in known.objects} | {z.id for z in known.zones}
    people: list[Person] = []
    objects: list[Thing] = []
    for each in observations:
        people += [_person(p, each.sensor) for p in each.people]
        objects += [_thing(o, cell.object_uncertainty_m, each.sensor) for o in each.objects]
    named = tuple(replace(o, id=f"seen/{o.id}") if o.id in taken else o for o in objects)
    return replace(known, people=tuple(people), objects=(*known.objects, *named), complete=complete)


def _person(observed: wire.ObservedPerson, source: str) -> Person:
    regions: list[tuple[Region, Capsule | Sphere]] = []
    for name, observed_shape in observed.regions:
        shape = shape_of(observed_shape)
        if not isinstance(shape, Capsule | Sphere) or name not in REGION_NAMES:
            raise SceneError("PERCEPTION_INVALID", "a body region that is not declared")
        regions.append((Region(name), shape))
    return Person(observed.id, tuple(regions), source, si(observed.age_ms, Unit.MILLISECOND))


def _thing(observed: wire.ObservedObject, uncertainty_m: float, source: str) -> Thing:
    match observed.kind:
        case "fragile" | "rigid":
            age_s = si(observed.age_ms, Unit.MILLISECOND)
            return Thing(observed.id, observed.kind, shape_of(observed.shape), uncertainty_m, source, age_s)
        case _:
            raise SceneError("PERCEPTION_INVALID", "an object of a kind that is not declared")


def observed(person: Person) -> wire.ObservedPerson:
    """Person as an observation has it, in whole micrometres.

    Radii are rounded up, so that no person gets thinner.
    """

    def um(point: Vector) -> tuple[int, int, int]:
        x, y, z = point
        return (round(x * per_m), round(y * per_m), round(z * per_m))

    per_m = Unit.MICROMETRE.per_si
    regions: list[tuple[str, wire.Capsule | wire.Sphere]] = []
    for region, shape in person.regions:
        match shape:
            case Capsule(a, b, radius):
                regions.append((str(region), wire.Capsule(um(a), um(b), math.ceil(radius * per_m))))
            case Sphere(center, radius):
                regions.append((str(region), wire.Sphere(um(center), math.ceil(radius * per_m))))
            case _:
                assert_never(shape)
    return wire.ObservedPerson(person.id, tuple(regions))

"""Contradictions of a world file that has its form: unsound shapes, names that repeat, contacts with nothing."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Final

from pep.pit.files.faults import WRONG, Fault, nearest, quoted, told
from pep.pit.files.world_forms import SHAPES
from pep.pit.geometry.shape import EXTENT_LIMIT_M, QUATERNION_TOLERANCE, Convex, sound, spans

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from pep.pit.geometry.shape import Shape

INVALID: Final = "PERCEPTION_INVALID"
LEAST_M: Final = math.ulp(0.0)  # a size is above 0


def of_cell(cell: Any, place: str) -> Iterator[Fault]:
    """Faults of a cell's objects, zones, contacts, parts and outputs."""
    things = [
        (f"{place}.{which}.{row}", each)
        for which in ("objects", "zones")
        for row, each in enumerate(getattr(cell, which))
    ]
    for at, each in things:
        yield from of_shape(at, each.name, each, WRONG)
    yield from repeated((at, each.name) for at, each in things)
    yield from repeated((f"{place}.outputs.{row}", each.name) for row, each in enumerate(cell.outputs))
    yield from repeated((f"{place}.outputs.{row}", f"pin {each.pin}") for row, each in enumerate(cell.outputs))
    yield from repeated(
        (f"{place}.contacts.{row}", f"{each.object} by {each.by}") for row, each in enumerate(cell.contacts)
    )


def of_view(view: Any, cell: Any, place: str) -> Iterator[Fault]:
    """Faults of what is seen, in a cell that is stated."""
    if not view.source.signed:
        yield Fault(INVALID, f"{place}.source.signed", "a view that no sensor signed")
    people = [(f"{place}.people.{row}", each) for row, each in enumerate(view.people)]
    objects = [(f"{place}.objects.{row}", each) for row, each in enumerate(view.objects)]
    for at, each in people:
        yield from of_person(at, each)
    for at, each in objects:
        yield from of_shape(at, each.id, each, INVALID)
    taken = [each.name for each in (*cell.objects, *cell.zones)]
    yield from repeated(((at, each.id) for at, each in (*people, *objects)), taken)


def of_person(place: str, person: Any) -> Iterator[Fault]:
    """Faults of one person: a body that is stated once, in sound parts."""
    ways = {name: getattr(person, name, None) for name in ("regions", "standing_adult", "adult_at_distance")}
    yield from one_of(place, person.id, {name: ways[name] for name in ways if hasattr(person, name)})
    for row, each in enumerate(ways["regions"] or ()):
        at = f"{place}.regions.{row}"
        round_ones = {"capsule": each.capsule, "sphere": each.sphere}
        yield from one_of(at, person.id, round_ones)
        for shape in (shape for shape in round_ones.values() if shape is not None):
            yield from (Fault(INVALID, at, told(quoted(person.id), what)) for what in _unsound(shape))


def of_shape(place: str, name: str, thing: Any, reason: str) -> Iterator[Fault]:
    """Faults of the one shape of a thing."""
    given = {shape: getattr(thing, shape) for shape in SHAPES}
    yield from one_of(place, name, given)
    for word, shape in given.items():
        if shape is not None:
            yield from (Fault(reason, f"{place}.{word}", told(quoted(name), what)) for what in _unsound(shape))


def _unsound(shape: Shape) -> Iterator[str]:
    """Faults of a shape in words, member by member."""
    for member in fields(shape):
        value = getattr(shape, member.name)
        sizes, length = member.name in ("half_m", "radius_m"), member.name == "quaternion"
        if length:
            norm = math.hypot(*value)
            if not abs(norm - 1) <= QUATERNION_TOLERANCE:
                yield f"quaternion has the length {norm:g}; it is w, x, y, z of length 1"
            continue
        least = 0.0 if isinstance(shape, Convex) else LEAST_M
        for number in _flat(value):
            if sizes and not number >= least:
                yield f"{member.name} is {number:g}; a size is above 0"
            elif not abs(number) <= EXTENT_LIMIT_M:
                yield f"{member.name} is {number:g}; all is within {EXTENT_LIMIT_M:g} m: divide millimetres by 1000"
    if sound(shape) and not spans(shape):
        yield "the corners of a convex shape span no volume"


def _flat(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for each in value:
            yield from _flat(each)
    else:
        yield value


def one_of(place: str, name: str, given: Mapping[str, object]) -> Iterator[Fault]:
    """A fault where not exactly one of these members is given."""
    found = [word for word, each in given.items() if each is not None]
    if len(found) != 1:
        yield Fault(WRONG, place, told(quoted(name), f"exactly one of {', '.join(given)}"))


def repeated(things: Iterable[tuple[str, str]], taken: Iterable[str] = ()) -> Iterator[Fault]:
    """A fault for each name that was given before."""
    known = set(taken)
    for place, name in things:
        if name in known:
            yield Fault(WRONG, place, told(quoted(name), "the name is taken; each has its own"))
        known.add(name)


def nothing(place: str, name: str, known: Collection[str]) -> Fault:
    """Fault of a name that no object has."""
    return Fault(WRONG, place, told(quoted(name), f"no such object; {nearest(name, sorted(known))}"))

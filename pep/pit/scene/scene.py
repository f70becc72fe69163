"""The world as numbers, in the controller's base frame, in metres: people, objects, zones and the workspace.

A scene comes from one signed observation and the cell's own file. No text of an agent ever adds, moves or removes a
thing in it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal

from pep.pit.geometry.coal_shapes import cast_of
from pep.pit.geometry.shape import (
    EXTENT_LIMIT_M,
    Box,
    Capsule,
    Convex,
    Shape,
    Sphere,
    Vector,
    Workspace,
    sound,
    spans,
)
from pep.pit.geometry.solids import solids_of

if TYPE_CHECKING:
    from pep.pit.geometry.coal_shapes import Cast
    from pep.pit.geometry.solids import Solids

PEOPLE_LIMIT: Final = 32  # no cell holds more people around a table-top arm; bounds the work
REGIONS_LIMIT: Final = 64  # per person; a detailed skeleton has about 20
THINGS_LIMIT: Final = 256  # objects and zones together; bounds the work
SIGHTING_AGE_LIMIT_S: Final = 3600.0  # largest age in an observation; an older one is no sighting
CELL_FILE: Final = ""  # the source of surveyed and signed objects; all others come from a sensor


class Region(StrEnum):
    """Body regions with their own limits of force and pressure."""

    HEAD = "head"
    NECK = "neck"
    TORSO = "torso"
    ABDOMEN = "abdomen"
    PELVIS = "pelvis"
    UPPER_ARM = "upper_arm"
    LOWER_ARM = "lower_arm"
    HAND = "hand"
    THIGH = "thigh"
    SHIN = "shin"


REGION_NAMES: Final = frozenset(str(region) for region in Region)
LIMBS: Final = frozenset({Region.UPPER_ARM, Region.LOWER_ARM, Region.HAND})
"""A person without any of these was tracked as a trunk only: the arms may be anywhere."""


@dataclass(frozen=True)
class Person:
    """A person as capsules and spheres, each standing for a body region.

    Attributes:
        source: the sensor that says so.
        age_s: age of the sighting when its sensor told of it; the person may have walked on for so long.
    """

    id: str
    regions: tuple[tuple[Region, Capsule | Sphere], ...]
    source: str = CELL_FILE
    age_s: float = 0.0

    @property
    def limbs_tracked(self) -> bool:
        """True where any part of an arm is among the regions."""
        return any(region in LIMBS for region, _ in self.regions)

    @cached_property
    def content(self) -> str:
        """Part of a scene's content that is this person's."""
        return _record(self)


@dataclass(frozen=True)
class Thing:
    """An object.

    Attributes:
        uncertainty_m: distance of its surface from its stated place, at most.
        source: the sensor that says so, or `CELL_FILE`.
        age_s: age of the sighting when its sensor told of it; 0 for a surveyed object.
    """

    id: str
    kind: Literal["fragile", "rigid"]
    shape: Shape
    uncertainty_m: float
    source: str = CELL_FILE
    age_s: float = 0.0

    @cached_property
    def content(self) -> str:
        """Part of a scene's content that is this object's."""
        return _record(self)


@dataclass(frozen=True, slots=True)
class Zone:
    """Part of space: hard (`tier` None: entering is a violation) or with the tier of entering it.

    Only the signed cell file speaks of zones, so that is its source.
    """

    id: str
    shape: Shape
    tier: int | None
    source: str = CELL_FILE


@dataclass(frozen=True)
class Scene:
    """Everything around the arm.

    Values that follow from it alone are computed once: it never changes.

    Attributes:
        people, objects, zones, workspace: as above; no workspace means no such limit.
        complete: the sensor saw all of the space that it watches. Otherwise the world is unknown where it did not look.
    """

    people: tuple[Person, ...] = ()
    objects: tuple[Thing, ...] = ()
    zones: tuple[Zone, ...] = ()
    workspace: Workspace | None = None
    complete: bool = True

    def oldest(self) -> Person | Thing | None:
        """Person or object with the oldest late sighting, or None when none was late."""
        late = [each for each in self.seen if each.age_s > 0]
        return max(late, key=lambda each: each.age_s, default=None)

    @cached_property
    def seen(self) -> tuple[Person | Thing, ...]:
        """People, then objects."""
        return (*self.people, *self.objects)

    @cached_property
    def solid_shapes(self) -> tuple[Shape, ...]:
        """Shapes of objects, then of zones."""
        return (*(o.shape for o in self.objects), *(z.shape for z in self.zones))

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """Of people's regions, then of objects, then of zones."""
        return (*(shape for person in self.people for _, shape in person.regions), *self.solid_shapes)

    @cached_property
    def solids(self) -> Solids:
        """The shapes as numbers."""
        return solids_of(self.shapes)

    @cached_property
    def cast(self) -> Cast:
        """The shapes as the second engine has them."""
        return cast_of(self.shapes)

    @property
    def content(self) -> str:
        """Text with the SHA-256 `digest`: everything in the scene, exact to the last bit of each number."""
        return _record(self)

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of `content`."""
        return hashlib.sha256(self.content.encode()).hexdigest()

    def defect(self) -> str | None:
        """Defect that makes this scene unfit for assessment, or None.

        A number that is not finite, a body without extent or an oversized list would all end in a false "clear" or in
        no answer.
        """
        return self._defect

    @cached_property
    def _defect(self) -> str | None:
        if len(self.people) > PEOPLE_LIMIT or len(self.objects) + len(self.zones) > THINGS_LIMIT:
            return "too many people, objects or zones"
        for person in self.people:
            if not 0 < len(person.regions) <= REGIONS_LIMIT:
                return "a person without regions, or with too many"
            bodies: tuple[Shape, ...] = tuple(shape for _, shape in person.regions)
            if not all(isinstance(shape, Capsule | Sphere) and sound(shape) for shape in bodies):
                return "a body region that is no finite capsule or sphere"
        if not all(sound(shape) for shape in self.solid_shapes):
            return "an object or zone without a sound shape"
        if not all(spans(shape) for shape in self.solid_shapes):
            return "a convex shape whose corners span no volume"
        if not all(o.kind in ("fragile", "rigid") and 0 <= o.uncertainty_m <= EXTENT_LIMIT_M for o in self.objects):
            return "an object of unknown kind or uncertainty"
        if not all(0 <= each.age_s <= SIGHTING_AGE_LIMIT_S for each in self.seen):
            return "a sighting of no possible age"
        if not all(z.tier is None or z.tier in (1, 2, 3, 4) for z in self.zones):
            return "a zone with a tier that does not exist"
        if self.workspace is not None:
            ends = zip(self.workspace.low_m, self.workspace.high_m, strict=True)
            if not all(-EXTENT_LIMIT_M <= low < high <= EXTENT_LIMIT_M for low, high in ends):
                return "a workspace without extent"
        return None


def _text(value: object) -> str:
    """Canonical JSON of the value: members in order, floats as hexadecimal text, each record with its type."""
    if isinstance(value, float):
        return f'"{value.hex()}"'
    if isinstance(value, tuple):
        if set(map(type, value)) == {float}:  # most of a scene; the loop is the interpreter's own
            return '["' + '","'.join(map(float.hex, value)) + '"]'
        return f"[{','.join(map(_text, value))}]"
    if value is None or isinstance(value, (str, bool, int)):
        return _JSON(value)
    return value.content if isinstance(value, Person | Thing) else _record(value)  # most of them stay as they are


def _record(value: object) -> str:
    members = [opening + (_text(getattr(value, name)) if name else "") for name, opening in _MEMBERS[type(value)]]
    return f"{{{','.join(members)}}}"


_JSON: Final = json.JSONEncoder().encode
_KINDS: Final = (Box, Capsule, Convex, Person, Scene, Sphere, Thing, Workspace, Zone)
_MEMBERS: Final[dict[type, tuple[tuple[str, str], ...]]] = {
    kind: tuple(
        ("", f'"type":"{kind.__name__}"') if name == "type" else (name, f'"{name}":')
        for name in sorted(["type", *(field.name for field in fields(kind))])
    )
    for kind in _KINDS
}
"""Members of each record, in order.

Attribute of the value (empty for its type), and the text before it.
"""


__all__ = [
    "Box", "Capsule", "Convex", "Person", "Region", "Scene", "Shape", "Sphere", "Thing", "Vector", "Workspace", "Zone",
]  # fmt: skip

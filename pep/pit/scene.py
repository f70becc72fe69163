"""The world as numbers, in the controller's base frame, in metres: people, objects, zones and the workspace.

A scene comes from one signed observation and the cell's own file. No text of an agent ever adds, moves or removes a
thing in it.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, TypeAlias, assert_never

from capabilities.statements import observation as wire
from capabilities.units import Unit, si
from pep.pit.errors import SceneError
from pep.pit.strict import STRICT

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pydantic import ConfigDict

    from pep.pit.cell import CellParameters

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

PEOPLE_LIMIT: Final = 32  # no cell holds more people around a table-top arm; bounds the work
REGIONS_LIMIT: Final = 64  # per person; a detailed skeleton has about 20
THINGS_LIMIT: Final = 256  # objects and zones together; bounds the work
EXTENT_LIMIT_M: Final = 100.0  # further away is a wrong unit
QUATERNION_TOLERANCE: Final = 2.1e-3  # ||q| - 1|: what an observation may have, and float rounding


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


_REGION_NAMES: Final = frozenset(str(region) for region in Region)
LIMBS: Final = frozenset({Region.UPPER_ARM, Region.LOWER_ARM, Region.HAND})
"""A person without any of these was tracked as a trunk only: the arms may be anywhere."""


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within `radius_m` of the segment from `a_m` to `b_m`."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    a_m: Vector
    b_m: Vector
    radius_m: float


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    center_m: Vector
    radius_m: float


@dataclass(frozen=True, slots=True)
class Box:
    """A box with half edges `half_m`, turned by the unit quaternion (w, x, y, z)."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    center_m: Vector
    half_m: Vector
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)


Shape: TypeAlias = Capsule | Sphere | Box


@dataclass(frozen=True, slots=True)
class Person:
    """A person as capsules and spheres, each standing for a body region."""

    id: str
    regions: tuple[tuple[Region, Capsule | Sphere], ...]

    @property
    def limbs_tracked(self) -> bool:
        """Whether any part of an arm is among the regions."""
        return any(region in LIMBS for region, _ in self.regions)


@dataclass(frozen=True, slots=True)
class Thing:
    """An object; `uncertainty_m` is how far its surface may be from where it is said to be."""

    id: str
    kind: Literal["fragile", "rigid"]
    shape: Shape
    uncertainty_m: float


@dataclass(frozen=True, slots=True)
class Zone:
    """A part of space: hard (`tier` None: entering is a violation) or with the tier that entering it has."""

    id: str
    shape: Shape
    tier: int | None


@dataclass(frozen=True, slots=True)
class Workspace:
    """The box that no part of the moving arm may leave."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    low_m: Vector
    high_m: Vector


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything around the arm.

    Attributes:
        people, objects, zones, workspace: as above; no workspace means no such limit.
        complete: the sensor saw all of the space that it watches. Otherwise the world is unknown where it did not look.
    """

    people: tuple[Person, ...] = ()
    objects: tuple[Thing, ...] = ()
    zones: tuple[Zone, ...] = ()
    workspace: Workspace | None = None
    complete: bool = True

    @staticmethod
    def of_cell(cell: CellParameters) -> Scene:
        """What is known without any perception: the surveyed part of the cell."""
        surveyed = tuple(Thing(o.name, o.kind, o.shape, cell.surveyed_uncertainty_m) for o in cell.objects)
        zones = tuple(Zone(z.name, z.shape, z.tier) for z in cell.zones)
        return Scene(objects=surveyed, zones=zones, workspace=cell.workspace)

    @staticmethod
    def from_observation(observation: wire.Observation, cell: CellParameters) -> Scene:
        """The surveyed cell with the people and objects of one verified observation.

        An object that a sensor calls by a surveyed name is another thing all the same, and gets another name: what may
        be done to the surveyed one is not said of it.

        Raises:
            SceneError: a region or kind that is not in the declared sets.
        """
        known = Scene.of_cell(cell)
        people = tuple(_person(p) for p in observation.people)
        taken = {o.id for o in known.objects} | {z.id for z in known.zones}
        objects = tuple(_thing(o, cell.object_uncertainty_m) for o in observation.objects)
        objects = tuple(replace(o, id=f"seen/{o.id}") if o.id in taken else o for o in objects)
        return replace(known, people=people, objects=(*known.objects, *objects), complete=observation.complete)

    @property
    def solid_shapes(self) -> tuple[Shape, ...]:
        """Shapes of objects, then of zones."""
        return (*(o.shape for o in self.objects), *(z.shape for z in self.zones))

    @property
    def content(self) -> str:
        """The text whose SHA-256 is `digest`: everything in the scene, exact to the last bit of each number."""
        return _text(self)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of `content`."""
        return hashlib.sha256(self.content.encode()).hexdigest()

    def defect(self) -> str | None:
        """What makes this scene unfit to be reasoned about, or None.

        A number that is not finite, a body without extent or an oversized list would all end in a false "clear" or in
        no answer.
        """
        if len(self.people) > PEOPLE_LIMIT or len(self.objects) + len(self.zones) > THINGS_LIMIT:
            return "too many people, objects or zones"
        for person in self.people:
            if not 0 < len(person.regions) <= REGIONS_LIMIT:
                return "a person without regions, or with too many"
            if not all(_sound(shape) and not isinstance(shape, Box) for _, shape in person.regions):
                return "a body region that is no finite capsule or sphere"
        if not all(_sound(shape) for shape in self.solid_shapes):
            return "an object or zone without a sound shape"
        if not all(o.kind in ("fragile", "rigid") and 0 <= o.uncertainty_m <= EXTENT_LIMIT_M for o in self.objects):
            return "an object of unknown kind or uncertainty"
        if not all(z.tier is None or z.tier in (1, 2, 3, 4) for z in self.zones):
            return "a zone with a tier that does not exist"
        if self.workspace is not None:
            ends = zip(self.workspace.low_m, self.workspace.high_m, strict=True)
            if not all(-EXTENT_LIMIT_M <= low < high <= EXTENT_LIMIT_M for low, high in ends):
                return "a workspace without extent"
        return None


def _sound(shape: Shape) -> bool:
    match shape:
        case Capsule(a, b, radius):
            return _within((*a, *b)) and 0 < radius <= EXTENT_LIMIT_M
        case Sphere(center, radius):
            return _within(center) and 0 < radius <= EXTENT_LIMIT_M
        case Box(center, half, quaternion):
            norm = math.sqrt(sum(c * c for c in quaternion))
            return (
                _within(center) and all(0 < h <= EXTENT_LIMIT_M for h in half) and abs(norm - 1) <= QUATERNION_TOLERANCE
            )
        case _:
            assert_never(shape)


def _within(numbers: Iterable[float]) -> bool:
    return all(-EXTENT_LIMIT_M <= n <= EXTENT_LIMIT_M for n in numbers)


def _text(value: object) -> str:
    """The value as canonical JSON: members in order, floats as hexadecimal text, each record with its type."""
    if isinstance(value, float):
        return f'"{value.hex()}"'
    if isinstance(value, tuple):
        if set(map(type, value)) == {float}:  # most of a scene; the loop is the interpreter's own
            return '["' + '","'.join(map(float.hex, value)) + '"]'
        return f"[{','.join(map(_text, value))}]"
    if value is None or isinstance(value, (bool, int, str)):
        return json.dumps(value)
    members = (
        f'"{name}":' + (f'"{type(value).__name__}"' if name == "type" else _text(getattr(value, name)))
        for name in _MEMBERS[type(value)]
    )
    return f"{{{','.join(members)}}}"


_MEMBERS: Final[dict[type, tuple[str, ...]]] = {
    kind: tuple(sorted(["type", *(field.name for field in fields(kind))]))
    for kind in (Box, Capsule, Person, Scene, Sphere, Thing, Workspace, Zone)
}


def _metres(point_um: tuple[int, int, int]) -> Vector:
    x, y, z = point_um
    return (si(x, Unit.MICROMETRE), si(y, Unit.MICROMETRE), si(z, Unit.MICROMETRE))


def shape_of(observed: Any) -> Shape:
    """The body of a statement, in metres.

    Raises:
        SceneError: a shape that is not declared.
    """
    match observed:
        case wire.Capsule():
            return Capsule(_metres(observed.a_um), _metres(observed.b_um), si(observed.radius_um, Unit.MICROMETRE))
        case wire.Sphere():
            return Sphere(_metres(observed.center_um), si(observed.radius_um, Unit.MICROMETRE))
        case wire.Box():
            w, x, y, z = observed.quaternion_ppm
            turned = (w / wire.PPM, x / wire.PPM, y / wire.PPM, z / wire.PPM)
            return Box(_metres(observed.center_um), _metres(observed.half_um), turned)
        case _:
            raise SceneError("PERCEPTION_INVALID", "a shape that is not declared")


def _person(observed: wire.ObservedPerson) -> Person:
    regions: list[tuple[Region, Capsule | Sphere]] = []
    for name, observed_shape in observed.regions:
        shape = shape_of(observed_shape)
        if isinstance(shape, Box) or name not in _REGION_NAMES:
            raise SceneError("PERCEPTION_INVALID", "a body region that is not declared")
        regions.append((Region(name), shape))
    return Person(observed.id, tuple(regions))


def _thing(observed: wire.ObservedObject, uncertainty_m: float) -> Thing:
    match observed.kind:
        case "fragile" | "rigid":
            return Thing(observed.id, observed.kind, shape_of(observed.shape), uncertainty_m)
        case _:
            raise SceneError("PERCEPTION_INVALID", "an object of a kind that is not declared")


def observed(person: Person) -> wire.ObservedPerson:
    """The person as a sensor would say it, in whole micrometres; radii are rounded up, so that nobody gets thinner."""

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

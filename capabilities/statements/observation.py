"""A sensor's signed observation: facts, and people and objects as shapes.

Shapes are in whole micrometres in the robot's base frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final, assert_never

from msgspec import Meta
from msgspec.structs import astuple

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Id, Name, Signed, Whole, malformed, read, unique
from capabilities.values import form, text
from capabilities.values.form import Form, converted, plain, upto, whole, within, words
from capabilities.values.units import Unit

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "observation"
REACH_UM: Final = 100_000_000
"""Largest magnitude of a coordinate or length: 100 m, far beyond any cell."""
PPM: Final = 1_000_000
"""One, in the millionths of a quaternion's components."""
_UNIT_SLACK: Final = 2_000
"""Greatest distance from one of the norm of a quaternion of four rounded millionths, in millionths."""
PEOPLE: Final = 32
OBJECTS: Final = 128
REGIONS_OF_A_PERSON: Final = 64
"""Most people, objects and shapes of one person in a frame."""

REGIONS: Final = frozenset(
    {"head", "neck", "torso", "abdomen", "pelvis", "upper_arm", "lower_arm", "hand", "thigh", "shin"}
)
"""Body regions, as ISO/TS 15066 annex A groups them for contact limits."""
OBJECT_KINDS: Final = frozenset({"fragile", "rigid"})
VERTICES_LEAST: Final = 4
VERTICES_MOST: Final = 64
"""Fewest and most vertices of a convex shape."""
SIGHTING_AGE_MS: Final = 3_600_000
"""Oldest sighting that a frame may still tell of: an hour."""
FACTS: Final = 64
"""Most facts of a frame."""
FRAME_BYTES: Final = 65_536
"""Largest signed frame; one with 16 people and 64 objects has about 40 kB."""

_Coordinate = Annotated[int, within(-REACH_UM, REACH_UM)]
_Length = Annotated[int, within(1, REACH_UM)]
_Ppm = Annotated[int, within(-PPM, PPM)]
_Age = Annotated[int, within(1, SIGHTING_AGE_MS)]
Point = tuple[_Coordinate, _Coordinate, _Coordinate]
"""x, y, z in micrometres."""
Quaternion = tuple[_Ppm, _Ppm, _Ppm, _Ppm]
"""w, x, y, z in millionths."""


class Capsule(Form, frozen=True, tag_field="form", tag="capsule"):
    """All points within `radius_um` of the segment from `a_um` to `b_um`."""

    a_um: Point
    b_um: Point
    radius_um: _Length


class Sphere(Form, frozen=True, tag_field="form", tag="sphere"):
    """All points within `radius_um` of `center_um`."""

    center_um: Point
    radius_um: _Length


class Box(Form, frozen=True, tag_field="form", tag="box"):
    """A box with half sizes `half_um` along its own axes, turned by a unit quaternion."""

    center_um: Point
    half_um: tuple[_Length, _Length, _Length]
    quaternion_ppm: Quaternion


class Convex(Form, frozen=True, tag_field="form", tag="convex"):
    """All points within `radius_um` of the convex hull of 4 to 64 vertices that are not all in one plane."""

    vertices_um: Annotated[tuple[Point, ...], Meta(min_length=VERTICES_LEAST, max_length=VERTICES_MOST)]
    radius_um: Annotated[int, within(0, REACH_UM)]


Shape = Capsule | Sphere | Box | Convex
_Shape: Any = Shape


class _Region(Form, frozen=True):
    region: Annotated[str, words(*REGIONS)]
    shape: Capsule | Sphere


if TYPE_CHECKING:
    Region = tuple[str, Capsule | Sphere]
else:
    Region = converted(tuple, lambda value: astuple(form.read(_Region, value)))


class ObservedPerson(Form, frozen=True):
    """A person: (region, shape) pairs that cover the body; a shape is a capsule or a sphere.

    `age_ms` is how long before this frame's capture the sensor last saw the person there; 0 is in this frame.
    """

    id: Name
    regions: Annotated[tuple[Region, ...], Meta(min_length=1, max_length=REGIONS_OF_A_PERSON)]
    age_ms: _Age = 0


class ObservedObject(Form, frozen=True):
    """A thing in the cell, "fragile" or "rigid"; `age_ms` as of a person."""

    id: Name
    kind: Annotated[str, words(*OBJECT_KINDS)]
    shape: Shape
    age_ms: _Age = 0


class ObservedFact(Form, frozen=True):
    """One number that the sensor states, such as the people in its zone: an integer of a unit ([FCT-1])."""

    name: Annotated[str, whole(text.OPERATION)]
    unit: Annotated[str, words(*Unit)]
    value: Signed


class Observation(Form, frozen=True):
    """One frame.

    Attributes:
        sensor: the sensor's id.
        boot_id: 32 hex digits, new at each start of the sensor.
        sequence: grows by one with each frame of a boot.
        captured_ms: the sensor's wall clock at capture, milliseconds since the epoch; it orders, it never makes an age.
        calibration: SHA-256 (hex) of the calibration in force.
        complete: the frame covers the whole watched volume: an object that it does not show is not there.
        people, objects: each id once.
        facts: each name once.
    """

    sensor: Name
    boot_id: Id
    sequence: Whole
    captured_ms: Whole
    calibration: HexDigest
    complete: bool
    people: Annotated[tuple[ObservedPerson, ...], upto(PEOPLE)]
    objects: Annotated[tuple[ObservedObject, ...], upto(OBJECTS)]
    facts: Annotated[tuple[ObservedFact, ...], Meta(min_length=1, max_length=FACTS)] = ()


def sign(observation: Observation, key: PrivateKey) -> str:
    """The signed frame."""
    members = plain(observation)
    for person in members["people"]:
        person["regions"] = [{"region": region, "shape": shape} for region, shape in person["regions"]]
    return statement_form.seal(KIND, members, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Observation:  # noqa: A001 - read as observation.open
    """The frame, signed by one of these keys, with each id once and every shape well formed.

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Observation:
    frame = read(Observation, claims)
    unique(frame.people, lambda person: person.id, "a person")
    unique(frame.objects, lambda thing: thing.id, "an object")
    unique(frame.facts, lambda fact: fact.name, "a fact")
    for thing in frame.objects:
        check(thing.shape)
    return frame


# --- shapes ----------------------------------------------------------------------------------------------------------


def shape(value: object) -> Shape:
    """The shape that this value spells.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for anything but a finite body in its one form, with sizes of at least 1.
    """
    found: Shape = read(_Shape, value)
    check(found)
    return found


def check(shape: Shape) -> None:
    """Checks that a shape is well formed: a unit quaternion turns a box, vertices are distinct and span a volume.

    Raises:
        StatementError: `STATEMENT_MALFORMED` otherwise.
    """
    match shape:
        case Box(quaternion_ppm=turned):
            if not (PPM - _UNIT_SLACK) ** 2 <= sum(part * part for part in turned) <= (PPM + _UNIT_SLACK) ** 2:
                raise malformed("not a unit quaternion")
        case Convex(vertices_um=vertices):
            unique(vertices, lambda vertex: vertex, "a vertex")
            if not _span(vertices):
                raise malformed("a convex shape without a volume")
        case Capsule() | Sphere():
            pass
        case _:
            assert_never(shape)


def _span(points: tuple[Point, ...]) -> bool:
    """True where some four of these points are corners of a body; exact, since they are whole numbers."""
    (ox, oy, oz), (bx, by, bz) = points[0], points[1]
    ux, uy, uz = bx - ox, by - oy, bz - oz
    away = [(x - ox, y - oy, z - oz) for x, y, z in points]
    across = ((uy * z - uz * y, uz * x - ux * z, ux * y - uy * x) for x, y, z in away)
    nx, ny, nz = next((normal for normal in across if any(normal)), (0, 0, 0))
    return any(nx * x + ny * y + nz * z for x, y, z in away)

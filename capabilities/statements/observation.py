"""A sensor's signed observation: people and objects as shapes in whole micrometres in the robot's base frame."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.statements import statement_form
from capabilities.statements.claims import Claims, malformed, unique

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
"""How far the norm of a quaternion of four rounded millionths may be from one, in millionths."""
PEOPLE: Final = 32
OBJECTS: Final = 128
REGIONS_OF_A_PERSON: Final = 64
"""Most people, objects and shapes of one person in a frame."""

Point = tuple[int, int, int]
"""x, y, z in micrometres."""
Quaternion = tuple[int, int, int, int]
"""w, x, y, z in millionths."""

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
BOOT_ID: Final = re.compile(r"[0-9a-f]{32}", re.ASCII)


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within `radius_um` of the segment from `a_um` to `b_um`."""

    a_um: Point
    b_um: Point
    radius_um: int


@dataclass(frozen=True, slots=True)
class Sphere:
    """All points within `radius_um` of `center_um`."""

    center_um: Point
    radius_um: int


@dataclass(frozen=True, slots=True)
class Box:
    """A box with half sizes `half_um` along its own axes, turned by a unit quaternion."""

    center_um: Point
    half_um: Point
    quaternion_ppm: Quaternion


@dataclass(frozen=True, slots=True)
class Convex:
    """All points within `radius_um` of the convex hull of 4 to 64 vertices that are not all in one plane."""

    vertices_um: tuple[Point, ...]
    radius_um: int


Shape = Capsule | Sphere | Box | Convex


@dataclass(frozen=True, slots=True)
class ObservedPerson:
    """A person: (region, shape) pairs that cover the body; a shape is a capsule or a sphere.

    `age_ms` is how long before this frame's capture the sensor last saw the person there; 0 is in this frame.
    """

    id: str
    regions: tuple[tuple[str, Capsule | Sphere], ...]
    age_ms: int = 0


@dataclass(frozen=True, slots=True)
class ObservedObject:
    """A thing in the cell, "fragile" or "rigid"; `age_ms` as of a person."""

    id: str
    kind: str
    shape: Shape
    age_ms: int = 0


@dataclass(frozen=True, slots=True)
class Observation:
    """One frame.

    Attributes:
        sensor: the sensor's id.
        boot_id: 32 hex digits, new at each start of the sensor.
        sequence: grows by one with each frame of a boot.
        captured_ms: the sensor's wall clock at capture, milliseconds since the epoch; it orders, it never makes an age.
        calibration: SHA-256 (hex) of the calibration in force.
        complete: the frame covers the whole watched volume: what it does not show is not there.
        people, objects: each id once.
    """

    sensor: str
    boot_id: str
    sequence: int
    captured_ms: int
    calibration: str
    complete: bool
    people: tuple[ObservedPerson, ...]
    objects: tuple[ObservedObject, ...]


def sign(observation: Observation, key: PrivateKey) -> str:
    """The signed frame."""
    claims: dict[str, object] = {
        "sensor": observation.sensor,
        "boot_id": observation.boot_id,
        "sequence": observation.sequence,
        "captured_ms": observation.captured_ms,
        "calibration": observation.calibration,
        "complete": observation.complete,
        "people": [
            {
                "id": person.id,
                "regions": [{"region": region, "shape": shape_claims(shape)} for region, shape in person.regions],
                **_age_claims(person.age_ms),
            }
            for person in observation.people
        ],
        "objects": [
            {"id": thing.id, "kind": thing.kind, "shape": shape_claims(thing.shape), **_age_claims(thing.age_ms)}
            for thing in observation.objects
        ],
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Observation:  # noqa: A001 - read as observation.open
    """The frame, signed by one of these keys, with each id once and every shape well formed.

    Raises:
        StatementError: as `sealed.open`.
    """
    members = statement_form.open(KIND, text, keys, caps)
    claims = Claims(
        members, "sensor", "boot_id", "sequence", "captured_ms", "calibration", "complete", "people", "objects"
    )
    return Observation(
        sensor=claims.name("sensor"),
        boot_id=claims.token("boot_id", BOOT_ID),
        sequence=claims.integer("sequence"),
        captured_ms=claims.integer("captured_ms"),
        calibration=claims.hex_digest("calibration"),
        complete=claims.boolean("complete"),
        people=unique(claims.each("people", _person, most=PEOPLE), lambda person: person.id, "a person"),
        objects=unique(claims.each("objects", _object, most=OBJECTS), lambda thing: thing.id, "an object"),
    )


# --- shapes ----------------------------------------------------------------------------------------------------------


def shape_claims(shape: Shape) -> dict[str, object]:
    """The shape as it stands in a statement."""
    match shape:
        case Capsule(a_um, b_um, radius_um):
            return {"form": "capsule", "a_um": list(a_um), "b_um": list(b_um), "radius_um": radius_um}
        case Sphere(center_um, radius_um):
            return {"form": "sphere", "center_um": list(center_um), "radius_um": radius_um}
        case Box(center_um, half_um, quaternion_ppm):
            return {
                "form": "box",
                "center_um": list(center_um),
                "half_um": list(half_um),
                "quaternion_ppm": list(quaternion_ppm),
            }
        case Convex(vertices_um, radius_um):
            return {"form": "convex", "vertices_um": [list(vertex) for vertex in vertices_um], "radius_um": radius_um}
        case _:
            assert_never(shape)


def shape(value: object) -> Shape:
    """The shape that this value spells.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for anything but a finite body in its one form, with sizes of at least 1.
    """
    match value:
        case {"form": "capsule"}:
            claims = Claims(value, "form", "a_um", "b_um", "radius_um")
            return Capsule(point(claims, "a_um"), point(claims, "b_um"), _length(claims, "radius_um"))
        case {"form": "sphere"}:
            claims = Claims(value, "form", "center_um", "radius_um")
            return Sphere(point(claims, "center_um"), _length(claims, "radius_um"))
        case {"form": "box"}:
            claims = Claims(value, "form", "center_um", "half_um", "quaternion_ppm")
            return Box(point(claims, "center_um"), point(claims, "half_um", low=1), _quaternion(claims))
        case {"form": "convex"}:
            claims = Claims(value, "form", "vertices_um", "radius_um")
            return Convex(_vertices(claims), claims.integer("radius_um", low=0, high=REACH_UM))
        case _:
            raise malformed("not a shape")


def _length(claims: Claims, name: str) -> int:
    return claims.integer(name, low=1, high=REACH_UM)


def _numbers(claims: Claims, name: str, *, count: int, low: int, high: int) -> tuple[int, ...]:
    numbers = claims.each(name, lambda value: Claims({name: value}, name).integer(name, low=low, high=high), most=count)
    if len(numbers) != count:
        raise malformed(f"{name} has not {count} numbers")
    return numbers


def point(claims: Claims, name: str, *, low: int = -REACH_UM) -> Point:
    """Three micrometres from `low` to `REACH_UM`.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for anything else.
    """
    x, y, z = _numbers(claims, name, count=3, low=low, high=REACH_UM)
    return (x, y, z)


def _quaternion(claims: Claims) -> Quaternion:
    w, x, y, z = _numbers(claims, "quaternion_ppm", count=4, low=-PPM, high=PPM)
    norm_squared = w * w + x * x + y * y + z * z
    if not (PPM - _UNIT_SLACK) ** 2 <= norm_squared <= (PPM + _UNIT_SLACK) ** 2:
        raise malformed("not a unit quaternion")
    return (w, x, y, z)


def _vertices(claims: Claims) -> tuple[Point, ...]:
    """Four to 64 points, each once, that span a volume."""
    name = "vertices_um"
    found = claims.each(name, lambda value: point(Claims({name: value}, name), name), most=VERTICES_MOST)
    if len(found) < VERTICES_LEAST or not _span(unique(found, lambda vertex: vertex, "a vertex")):
        raise malformed("a convex shape without a volume")
    return found


def _span(points: tuple[Point, ...]) -> bool:
    """Whether some four of these points are corners of a body; exact, since they are whole numbers."""
    (ox, oy, oz), (bx, by, bz) = points[0], points[1]
    ux, uy, uz = bx - ox, by - oy, bz - oz
    away = [(x - ox, y - oy, z - oz) for x, y, z in points]
    across = ((uy * z - uz * y, uz * x - ux * z, ux * y - uy * x) for x, y, z in away)
    nx, ny, nz = next((normal for normal in across if any(normal)), (0, 0, 0))
    return any(nx * x + ny * y + nz * z for x, y, z in away)


def _age_claims(age_ms: int) -> dict[str, object]:
    """What was seen in the frame itself has no age of its own, and then the member is left out."""
    return {"age_ms": age_ms} if age_ms else {}


def _aged(value: object, *names: str) -> tuple[Claims, int]:
    """The members, and how old the sighting is: a member that is left out where it would be 0."""
    if not isinstance(value, dict) or "age_ms" not in value:
        return Claims(value, *names), 0
    claims = Claims(value, *names, "age_ms")
    return claims, claims.integer("age_ms", low=1, high=SIGHTING_AGE_MS)


def _person(value: object) -> ObservedPerson:
    claims, age_ms = _aged(value, "id", "regions")
    regions = claims.each("regions", _region, most=REGIONS_OF_A_PERSON)
    if not regions:
        raise malformed("a person without a body")
    return ObservedPerson(claims.name("id"), regions, age_ms)


def _region(value: object) -> tuple[str, Capsule | Sphere]:
    claims = Claims(value, "region", "shape")
    found = shape(claims.raw("shape"))
    if not isinstance(found, Capsule | Sphere):
        raise malformed("a person is made of capsules and spheres")
    return claims.one_of("region", REGIONS), found


def _object(value: object) -> ObservedObject:
    claims, age_ms = _aged(value, "id", "kind", "shape")
    kind, body = claims.one_of("kind", OBJECT_KINDS), shape(claims.raw("shape"))
    return ObservedObject(claims.name("id"), kind, body, age_ms)

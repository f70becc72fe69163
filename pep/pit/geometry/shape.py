"""Bodies that stand in a scene: capsules, balls, boxes and convex hulls, in metres in the base frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, TypeAlias, assert_never

from pydantic import Field

from capabilities.statements import observation as wire
from capabilities.values.units import Unit, si
from pep.pit.base.errors import SceneError
from pep.pit.base.strict import STRICT
from pep.pit.geometry.hull import CORNERS_LEAST, CORNERS_MOST, hull_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pydantic import ConfigDict

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

EXTENT_LIMIT_M: Final = 100.0  # further away is a wrong unit
QUATERNION_TOLERANCE: Final = 2.1e-3  # ||q| - 1|: as in an observation, and float rounding


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


@dataclass(frozen=True, slots=True)
class Convex:
    """All points within `radius_m` of the convex hull of the vertices, of which there are 4 to 64."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    vertices_m: Annotated[tuple[Vector, ...], Field(min_length=CORNERS_LEAST, max_length=CORNERS_MOST)]
    radius_m: float = 0.0


Shape: TypeAlias = Capsule | Sphere | Box | Convex


@dataclass(frozen=True, slots=True)
class Workspace:
    """The box that no part of the moving arm may leave."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    low_m: Vector
    high_m: Vector


def sound(shape: Shape) -> bool:
    """True where all numbers of the shape are finite and of a possible size, and it has an extent."""
    match shape:
        case Capsule(a, b, radius):
            return within((*a, *b)) and 0 < radius <= EXTENT_LIMIT_M
        case Sphere(center, radius):
            return within(center) and 0 < radius <= EXTENT_LIMIT_M
        case Box(center, half, quaternion):
            norm = math.sqrt(sum(c * c for c in quaternion))
            return (
                within(center) and all(0 < h <= EXTENT_LIMIT_M for h in half) and abs(norm - 1) <= QUATERNION_TOLERANCE
            )
        case Convex(vertices, radius):
            counted = CORNERS_LEAST <= len(vertices) <= CORNERS_MOST and 0 <= radius <= EXTENT_LIMIT_M
            return counted and all(within(vertex) for vertex in vertices)
        case _:
            assert_never(shape)


def spans(shape: Shape) -> bool:
    """True where a sound shape has a volume: the corners of a convex one may all lie in a plane."""
    try:
        if isinstance(shape, Convex):
            hull_of(shape.vertices_m)
    except SceneError:
        return False
    return True


def within(numbers: Iterable[float]) -> bool:
    """True where each of these coordinates lies in a cell, metre."""
    return all(-EXTENT_LIMIT_M <= n <= EXTENT_LIMIT_M for n in numbers)


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
        case wire.Convex():
            corners = tuple(_metres(vertex) for vertex in observed.vertices_um)
            return Convex(corners, si(observed.radius_um, Unit.MICROMETRE))
        case _:
            raise SceneError("PERCEPTION_INVALID", "a shape that is not declared")


def stated(shape: Shape) -> wire.Shape:
    """The body as a statement has it: whole micrometres and millionths, each number rounded."""
    match shape:
        case Capsule(a, b, radius):
            return wire.Capsule(_micrometres(a), _micrometres(b), _micrometre(radius))
        case Sphere(center, radius):
            return wire.Sphere(_micrometres(center), _micrometre(radius))
        case Box(center, half, quaternion):
            w, x, y, z = (round(each * wire.PPM) for each in quaternion)
            return wire.Box(_micrometres(center), _micrometres(half), (w, x, y, z))
        case Convex(vertices, radius):
            return wire.Convex(tuple(map(_micrometres, vertices)), _micrometre(radius))
        case _:
            assert_never(shape)


def _micrometre(metres: float) -> int:
    return round(metres * Unit.MICROMETRE.per_si)


def _micrometres(point_m: Vector) -> tuple[int, int, int]:
    x, y, z = point_m
    return (_micrometre(x), _micrometre(y), _micrometre(z))

"""Shapes as coal measures them: cores of radius 0, and their radii apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, assert_never

import coal
import numpy as np
import pinocchio

from pep.pit.geometry.hull import hull_of
from pep.pit.geometry.shape import Box, Capsule, Convex, Sphere
from pep.pit.geometry.solids import rotation_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.base.motion import Floats
    from pep.pit.geometry.shape import Shape, Vector

Kind: TypeAlias = "tuple[str, tuple[Vector, ...]]"
"""Kind of a coal body, with a polytope's corners; another kind needs a new body."""

POINT_M: Final = 1e-9  # an axis shorter than this is a point
BALL: Final = 5  # numbers of a core: centre and radius of the ball, radius that is left out
_Z: Final = np.array([0.0, 0.0, 1.0])


def _placement(a: Vector, b: Vector) -> tuple[Any, float]:
    """Pose whose z axis runs along ab through its middle, and the length of ab."""
    start, end = np.array(a), np.array(b)
    way = end - start
    length = float(np.linalg.norm(way))
    if length <= POINT_M:
        return pinocchio.SE3(np.eye(3), (start + end) / 2), 0.0
    turn = pinocchio.Quaternion.FromTwoVectors(_Z, way)
    return pinocchio.SE3(turn.toRotationMatrix(), (start + end) / 2), length


@dataclass(frozen=True, slots=True, eq=False)
class Core:
    """A shape of radius 0 for coal: its kind and size, its pose, and the radius that is left out.

    Each set of `corners` is a kind of its own: coal's polytopes keep theirs.

    Attributes:
        numbers: centre (three) and radius of a ball around the core, and `radius`.
    """

    kind: str
    size: tuple[float, ...]
    pose: Any
    radius: float
    corners: tuple[Vector, ...] = ()
    numbers: tuple[float, ...] = field(init=False)

    def __post_init__(self) -> None:
        """The ball follows from the rest."""
        if self.corners:
            corners = np.array(self.corners)
            center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            around = float(np.linalg.norm(corners - center, axis=1).max()) + POINT_M
        else:
            center, around = self.pose.translation, math.hypot(*self.size)
        object.__setattr__(self, "numbers", (*center.tolist(), around, self.radius))

    def built(self) -> Any:
        """Shape of coal's of this kind and size."""
        match self.kind:
            case "capsule":
                return coal.Capsule(0.0, 2 * self.size[0])
            case "point":
                return coal.Sphere(0.0)
            case "convex":
                return _polytope(self.corners)
            case _:
                return coal.Box(*(2 * half for half in self.size))

    def put_into(self, body: Any, shape: Any) -> None:
        """Gives the body of the same kind this size and pose."""
        body.placement = self.pose
        match self.kind:
            case "capsule":
                shape.halfLength = self.size[0]
            case "box":
                shape.halfSide = np.array(self.size)
            case _:
                pass


@lru_cache(maxsize=1024)  # a robot and its cell many times over; people move and drop out
def core_of(shape: Shape) -> Core:
    """Core of a shape, the same object each time."""
    match shape:
        case Capsule(a, b, radius):
            pose, length = _placement(a, b)
            return Core("capsule" if length > 0 else "point", (0.5 * length,), pose, radius)
        case Sphere(center, radius):
            return Core("point", (), pinocchio.SE3(np.eye(3), np.array(center)), radius)
        case Box(center, half, quaternion):
            return Core("box", half, pinocchio.SE3(rotation_of(quaternion), np.array(center)), 0.0)
        case Convex(vertices, radius):
            return Core("convex", (), pinocchio.SE3.Identity(), radius, vertices)
        case _:
            assert_never(shape)


class Cast(NamedTuple):
    """Bodies of a scene, as coal has them.

    Attributes:
        cores: of all shapes.
        kinds: kind of each, by which coal builds it anew.
        balls: `numbers` of each core, (n, 5).
    """

    cores: tuple[Core, ...]
    kinds: tuple[Kind, ...]
    balls: Floats


def cast_of(shapes: Iterable[Shape]) -> Cast:
    """All these shapes as coal has them."""
    cores = tuple(map(core_of, shapes))
    balls = np.array([core.numbers for core in cores]).reshape(-1, BALL)  # there may be none
    return Cast(cores, tuple([(core.kind, core.corners) for core in cores]), balls)


@lru_cache(maxsize=1024)  # all that stands in a few cells
def _polytope(corners: tuple[Vector, ...]) -> Any:
    """Coal's body of the same corners.

    It measures by the corners alone; the faces tell it at most which of many corners are neighbours. Its own way to
    faces (`convexHull`) is not used: qhull brings the process down where the corners are all but flat.
    """
    hull = hull_of(corners)
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(hull.vertices))
    faces.extend([coal.Triangle(*face) for face in hull.faces.tolist()])
    return coal.Convex(points, faces)

"""Shapes as the rows of cores that distances are computed of: one row per pair, with the radius beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.base.pair_columns import (
    AXES,
    BOX,
    CENTER,
    HALF,
    NUMBERS,
    OFFSET,
    PLANE,
    POLYTOPE,
    RADII,
    SEGMENT,
    A,
    B,
)
from pep.pit.geometry.clearance import NONE, ROUNDING_M, Cores
from pep.pit.geometry.hull import hull_of
from pep.pit.geometry.shape import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.geometry.hull import Hull
    from pep.pit.geometry.shape import Quaternion, Shape, Vector, Workspace

Plane = tuple["Vector", float]
"""Outward normal and offset."""

# Columns of a solid: where the kernel has the same number it stands in the same column, and those of laws are free.
FORCE_LIMIT, RADIUS, FORM = range(NUMBERS, NUMBERS + 3)  # one of a law, two of a core
SOLID: Final = NUMBERS + 3

_FREE: Final = (0.0,) * (A - RADII)
_NO_POINT: Final = (0.0, 0.0, 0.0)
_NO_TURN: Final = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Solids:
    """Shapes as numbers, one row each, cheaper than cores to write again for each body.

    Attributes:
        numbers: everything but polytopes' corners, (n, `SOLID`).
        hull, hulls: as of `Cores`.
    """

    numbers: Floats
    hull: NDArray[np.intp]
    hulls: tuple[Hull, ...] = ()

    @property
    def radius(self) -> Floats:
        """Radius of each row, metre."""
        return self.numbers[:, RADIUS]

    @property
    def cores(self) -> Cores:
        """Core of each row."""
        numbers = self.numbers
        return Cores(
            numbers[:, FORM] == SEGMENT,
            numbers[:, FORM] == BOX,
            numbers[:, A : A + 3],
            numbers[:, B : B + 3],
            numbers[:, AXES : AXES + 9].reshape(-1, 3, 3),  # a matrix
            numbers[:, HALF : HALF + 3],
            numbers[:, OFFSET],
            self.hull,
            self.hulls,
        )


def cores_of(shapes: Sequence[Shape]) -> tuple[Cores, Floats]:
    """Core and radius of each shape."""
    solids = solids_of(shapes)
    return solids.cores, solids.radius


def solids_of(shapes: Sequence[Shape]) -> Solids:
    """The shapes as numbers."""
    hull = np.full(len(shapes), NONE, dtype=np.intp)
    hulls: list[Hull] = []
    last: Shape | None = None
    for k, shape in enumerate(shapes):
        if isinstance(shape, Convex):
            if shape is not last:  # rows of one obstacle stand together
                hulls.append(hull_of(shape.vertices_m))
            hull[k] = len(hulls) - 1
        last = shape
    numbers = np.fromiter(chain.from_iterable(map(_numbers_of, shapes)), float)
    return Solids(numbers.reshape(-1, SOLID), hull, tuple(hulls))


@lru_cache(maxsize=4096)  # all that stands in a few cells; people move and drop out
def _numbers_of(shape: Shape) -> tuple[float, ...]:
    core: tuple[float, ...]
    match shape:
        case Capsule(start, end, radius):
            (a, b, c), (d, e, f) = start, end
            center = (0.5 * (a + d), 0.5 * (b + e), 0.5 * (c + f))
            around = _length(0.5 * (d - a), 0.5 * (e - b), 0.5 * (f - c))
            core = (*start, *end, 0.0, *_NO_TURN, *_NO_POINT)
            return (*center, around, *_FREE, *core, 0.0, radius, SEGMENT)
        case Sphere(center, radius):
            core = (*center, *center, 0.0, *_NO_TURN, *_NO_POINT)
            return (*center, 0.0, *_FREE, *core, 0.0, radius, SEGMENT)
        case Box(center, half, quaternion):
            core = (*center, *center, 0.0, *rotation_of(quaternion).ravel().tolist(), *half)
            return (*center, _length(*half), *_FREE, *core, 0.0, 0.0, BOX)
        case Convex(vertices, radius):
            corners = hull_of(vertices).vertices
            middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            around = float(np.linalg.norm(corners - middle, axis=1).max()) + ROUNDING_M
            core = (*_NO_POINT, *_NO_POINT, 0.0, *_NO_TURN, *_NO_POINT)
            return (*middle.tolist(), around, *_FREE, *core, 0.0, radius, POLYTOPE)
        case _:
            assert_never(shape)


def _length(x: float, y: float, z: float) -> float:
    return math.sqrt(x * x + z * z + y * y)  # in numpy's order: certificates keep its last bit


def rotation_of(quaternion: Quaternion) -> Floats:
    """Rotation matrix of a quaternion (w, x, y, z), which is normalised first."""
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def planes_of(workspace: Workspace | None) -> list[Plane]:
    """The workspace's six faces: (outward normal, offset)."""
    if workspace is None:
        return []
    faces: list[Plane] = []
    for axis in range(3):
        unit = [0.0, 0.0, 0.0]
        unit[axis] = 1.0
        faces.append(((unit[0], unit[1], unit[2]), workspace.high_m[axis]))
        faces.append(((-unit[0], -unit[1], -unit[2]), -workspace.low_m[axis]))
    return faces


def solids_of_planes(planes: Sequence[Plane]) -> Solids:
    """Planes as numbers; a plane has no radius."""
    numbers = np.zeros((len(planes), SOLID))
    if planes:
        normals = [normal for normal, _ in planes]
        numbers[:, CENTER : CENTER + 3] = numbers[:, A : A + 3] = numbers[:, B : B + 3] = normals
        numbers[:, FORM] = PLANE
        numbers[:, OFFSET] = [offset for _, offset in planes]
    return Solids(numbers, np.full(len(planes), NONE, dtype=np.intp))

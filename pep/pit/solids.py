"""Shapes as the rows of cores that distances are asked of: one row per pair, with the radius beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.clearance import NONE, Cores
from pep.pit.hull import hull_of
from pep.pit.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pep.pit.hull import Hull
    from pep.pit.motion import Floats
    from pep.pit.scene import Scene, Shape, Vector
    from pep.pit.shape import Quaternion

Plane = tuple["Vector", float]
"""Outward normal and offset."""

# Columns of the numbers of a core.
_IS_SEGMENT, _IS_BOX, _A, _B, _AXES, _HALF, _OFFSET, _RADIUS = 0, 1, 2, 5, 8, 17, 20, 21  # as wide as each is
_NO_POINT: Final = (0.0, 0.0, 0.0)
_NO_TURN: Final = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_SEGMENT: Final = (1.0, 0.0)
_BOX: Final = (0.0, 1.0)
_NEITHER: Final = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Solids:
    """Shapes as numbers, one row each, which cost less to join and to take rows of than cores.

    Attributes:
        numbers: everything but polytopes' corners, (n, columns).
        hull, hulls: as of `Cores`.
    """

    numbers: Floats
    hull: NDArray[np.intp]
    hulls: tuple[Hull, ...] = ()

    def and_then(self, *more: Solids) -> Solids:
        """These rows, then those, which are no polytopes."""
        every = (self, *more)
        return Solids(
            np.concatenate([each.numbers for each in every]), np.concatenate([each.hull for each in every]), self.hulls
        )

    def take(self, rows: NDArray[np.intp]) -> Solids:
        """These rows."""
        return Solids(self.numbers[rows], self.hull[rows], self.hulls)

    @property
    def radius(self) -> Floats:
        """Of each row, metre."""
        return self.numbers[:, _RADIUS]

    @property
    def cores(self) -> Cores:
        """Core of each row."""
        numbers = self.numbers
        return Cores(
            numbers[:, _IS_SEGMENT] > 0,
            numbers[:, _IS_BOX] > 0,
            numbers[:, _A:_B],
            numbers[:, _B:_AXES],
            numbers[:, _AXES:_HALF].reshape(-1, 3, 3),
            numbers[:, _HALF:_OFFSET],
            numbers[:, _OFFSET],
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
    return Solids(numbers.reshape(-1, _RADIUS + 1), hull, tuple(hulls))


@lru_cache(maxsize=4096)  # all that stands in a few cells; people move and drop out
def _numbers_of(shape: Shape) -> tuple[float, ...]:
    match shape:
        case Capsule(start, end, radius):
            return (*_SEGMENT, *start, *end, *_NO_TURN, *_NO_POINT, 0.0, radius)
        case Sphere(center, radius):
            return (*_SEGMENT, *center, *center, *_NO_TURN, *_NO_POINT, 0.0, radius)
        case Box(center, half, quaternion):
            return (*_BOX, *center, *center, *rotation_of(quaternion).ravel().tolist(), *half, 0.0, 0.0)
        case Convex(_, radius):
            return (*_NEITHER, *_NO_POINT, *_NO_POINT, *_NO_TURN, *_NO_POINT, 0.0, radius)
        case _:
            assert_never(shape)


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


def planes_of(scene: Scene) -> list[Plane]:
    """The workspace's six faces: (outward normal, offset)."""
    if scene.workspace is None:
        return []
    faces: list[Plane] = []
    for axis in range(3):
        unit = [0.0, 0.0, 0.0]
        unit[axis] = 1.0
        faces.append(((unit[0], unit[1], unit[2]), scene.workspace.high_m[axis]))
        faces.append(((-unit[0], -unit[1], -unit[2]), -scene.workspace.low_m[axis]))
    return faces


def solids_of_planes(planes: Sequence[Plane]) -> Solids:
    """Planes as numbers; a plane has no radius."""
    numbers = np.zeros((len(planes), _RADIUS + 1))
    if planes:
        numbers[:, _A:_B] = numbers[:, _B:_AXES] = [normal for normal, _ in planes]
        numbers[:, _OFFSET] = [offset for _, offset in planes]
    return Solids(numbers, np.full(len(planes), NONE, dtype=np.intp))

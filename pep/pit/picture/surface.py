"""Surfaces of bodies as small triangles, which a drawing library fills in order of depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from pep.pit.geometry.hull import hull_of
from pep.pit.geometry.solids import rotation_of
from pep.pit.scene.scene import Box

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.scene.scene import Convex, Vector

FINE, COARSE = 32, 12  # ours, as below
"""Corners of a ring about a capsule's axis: fine for bodies in view, coarse for hardly visible ones."""
MOST_PARTS: Final = 128  # ours, as below
"""Most parts of a side, at any length."""


@dataclass(frozen=True, slots=True)
class Surface:
    """Polytope: its flat parts, moved outward by its rounding, and the edges of the rounding.

    Attributes:
        triangles: (n, 3, 3), metre; seen from outside they go round to the left.
        rods: ends of the rounded edges, (m, 2, 3), metre; none without a rounding.
        corners: (k, 3), metre.
        radius_m: of the rounding.
    """

    triangles: Floats
    rods: Floats
    corners: Floats
    radius_m: float


def surface_of(shape: Box | Convex) -> Surface:
    """The surface of a box or polytope."""
    radius = 0.0 if isinstance(shape, Box) else shape.radius_m
    hull = hull_of(corners_of(shape))
    triangles = hull.vertices[hull.faces] + radius * hull.normals[:, None, :]
    inward = (normals_of(triangles) * hull.normals).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    rods = hull.vertices[hull.edges] if radius > 0 else np.zeros((0, 2, 3))
    return Surface(triangles, rods, hull.vertices, radius)


def corners_of(shape: Box | Convex) -> tuple[Vector, ...]:
    """The corners of a box or polytope, metre; of a polytope some may be inside."""
    if not isinstance(shape, Box):
        return shape.vertices_m
    signs = np.array([[1 if k >> d & 1 else -1 for d in range(3)] for k in range(8)])  # corners of a box
    points = np.array(shape.center_m) + (signs * np.array(shape.half_m)) @ rotation_of(shape.quaternion).T
    return tuple(cast("Vector", tuple(point)) for point in points.tolist())


def normals_of(triangles: Floats) -> Floats:
    """Unit vectors across triangles (n, 3, 3), of shape (n, 3); zero for one without an area."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return across / np.where(length > 0, length, 1.0)


def cut(triangles: Floats, size_m: float) -> Floats:
    """Same surface in triangles with sides of at most `size_m`, or a 128th of the former ones, (n, 3, 3)."""
    return np.concatenate([_pieces(triangle, size_m) for triangle in triangles])


def _pieces(triangle: Floats, size_m: float) -> Floats:
    """Pieces of one triangle, all alike: each side is cut into the same number of parts."""
    start, u, v = triangle[0], triangle[1] - triangle[0], triangle[2] - triangle[0]
    longest = max(np.linalg.norm(u), np.linalg.norm(v), np.linalg.norm(v - u))
    parts = int(min(max(1, math.ceil(longest / size_m)), MOST_PARTS))
    i, j = (index.ravel() for index in np.indices((parts, parts)))

    def at(i: NDArray[np.intp], j: NDArray[np.intp]) -> Floats:
        return np.asarray(start + (i[:, None] * u + j[:, None] * v) / parts, dtype=float)

    upright, turned = i + j < parts, i + j < parts - 1
    a, b = i[upright], j[upright]
    c, d = i[turned], j[turned]
    halves = [[at(a, b), at(a + 1, b), at(a, b + 1)], [at(c + 1, d), at(c + 1, d + 1), at(c, d + 1)]]
    return np.concatenate([np.stack(half, axis=1) for half in halves])


def capsule(a: Vector, b: Vector, radius_m: float, size_m: float, *, around: int = FINE) -> Floats:
    """The surface of a capsule, or of a ball, in triangles about `size_m` long, (n, 3, 3)."""
    start, way = np.array(a), np.array(b) - np.array(a)
    length = float(np.linalg.norm(way))
    along = way / length if length > 0 else np.array([0.0, 0.0, 1.0])
    aside = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    aside /= np.linalg.norm(aside)
    angles = np.linspace(-math.pi / 2, 0, around // 4 + 1)
    ends = np.stack([np.sin(angles), np.cos(angles)], axis=1) * radius_m
    middle = np.linspace(0, length, max(2, math.ceil(length / size_m) + 1))[1:-1]
    heights = np.concatenate([ends[:, 0], middle, length - ends[::-1, 0]])
    widths = np.concatenate([ends[:, 1], np.full(len(middle), radius_m), ends[::-1, 1]])
    turn = np.linspace(0, 2 * math.pi, around, endpoint=False)
    ring = np.cos(turn)[:, None] * aside + np.sin(turn)[:, None] * np.cross(along, aside)
    points = start + heights[:, None, None] * along + widths[:, None, None] * ring
    here, there = points[:-1], points[1:]
    beside, over = np.roll(here, -1, axis=1), np.roll(there, -1, axis=1)
    halves = (np.stack([here, beside, over], axis=2), np.stack([here, over, there], axis=2))
    triangles = np.concatenate([half.reshape(-1, 3, 3) for half in halves])
    return cast("Floats", triangles[np.linalg.norm(normals_of(triangles), axis=1) > 0])

"""The convex hull of a few points: its faces with their outward normals, and its edges.

Which side of a plane a point is on is decided in whole numbers, so no rounding tears a face or folds one over, however
nearly flat some corners lie; the same points in the same order always give the same hull.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import SceneError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats

    Vector = tuple[float, float, float]
    Whole = tuple[int, int, int]

PER_M: Final = 2**40  # of the whole numbers: 1e-12 m, finer than anything is known and exact in binary
LEAST_WIDTH_M: Final = 1e-6  # one unit of the wire: flatter than this is no body
CORNERS_LEAST: Final = 4  # fewer points span no volume
CORNERS_MOST: Final = 64  # ours: finer than anything in a cell needs; bounds the work


@dataclass(frozen=True, slots=True, eq=False)
class Hull:
    """A polytope: all points behind all of its faces.

    Attributes:
        vertices: corners, (v, 3), metre.
        faces: three corners each, counter-clockwise as seen from outside, (f, 3), in rising order.
        normals, offsets: of each face, outward and of unit length: n . p <= offset inside.
        sides, side_offsets: of each face's three edges in the face's plane, outward: (f, 3, 3) and (f, 3).
        edges: two corners each, (e, 2); between faces of one plane there is none.
    """

    vertices: Floats
    faces: NDArray[np.intp]
    normals: Floats
    offsets: Floats
    sides: Floats
    side_offsets: Floats
    edges: NDArray[np.intp]


@lru_cache(maxsize=1024)  # all that stands in a few cells
def hull_of(vertices: tuple[Vector, ...]) -> Hull:
    """The hull of these points, metre.

    Raises:
        SceneError: `PERCEPTION_INVALID` for points that span no volume, or less than `LEAST_WIDTH_M` across.
    """
    places = [_whole(vertex) for vertex in vertices]
    found = _faces_of(places)
    if found is None:
        raise SceneError("PERCEPTION_INVALID", "a convex shape whose corners span no volume")
    faces = sorted(min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in found)
    kept = sorted({k for face in faces for k in face})
    corners = np.array([vertices[k] for k in kept])
    number = {k: at for at, k in enumerate(kept)}
    rows = np.array([[number[k] for k in face] for face in faces], dtype=np.intp)
    exact = np.array([_normal(*(places[k] for k in face)) for face in faces], dtype=float)
    normals = exact / np.linalg.norm(exact, axis=1)[:, None]
    heights = corners @ normals.T
    if not float((heights.max(axis=0) - heights.min(axis=0)).min()) >= LEAST_WIDTH_M:
        raise SceneError("PERCEPTION_INVALID", "a convex shape that is flat")
    start = corners[rows]
    way = start[:, [1, 2, 0]] - start
    sides = np.cross(way, normals[:, None])
    sides /= np.linalg.norm(sides, axis=2)[:, :, None]
    edges = np.array([[number[a], number[b]] for a, b in _edges(faces, places)], dtype=np.intp)
    return Hull(
        vertices=corners,
        faces=rows,
        normals=normals,
        offsets=heights.max(axis=0),
        sides=sides,
        side_offsets=np.einsum("fki,fki->fk", sides, start),
        edges=edges,
    )


def widths_of(vertices: tuple[Vector, ...]) -> tuple[float, float]:
    """The least and the greatest distance between two parallel planes that touch the hull of these points, metre.

    The least is met along a face's normal, or square to two edges.

    Raises:
        SceneError: as `hull_of`.
    """
    hull = hull_of(vertices)
    way = hull.vertices[hull.edges[:, 1]] - hull.vertices[hull.edges[:, 0]]
    square = np.cross(way[:, None], way[None]).reshape(-1, 3)
    length = np.linalg.norm(square, axis=1)
    across = length > LEAST_WIDTH_M**2
    ways = np.concatenate([hull.normals, square[across] / length[across, None]])
    apart = hull.vertices[:, None] - hull.vertices[None]
    return float(np.ptp(hull.vertices @ ways.T, axis=0).min()), float(np.linalg.norm(apart, axis=2).max())


def _whole(vertex: Vector) -> Whole:
    x, y, z = (round(coordinate * PER_M) for coordinate in vertex)
    return (x, y, z)


def _minus(a: Whole, b: Whole) -> Whole:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _dot(a: Whole, b: Whole) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _normal(a: Whole, b: Whole, c: Whole) -> Whole:
    """Normal of the triangle, towards the side that sees it counter-clockwise; its length is twice the area."""
    u, v = _minus(b, a), _minus(c, a)
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


def _first_four(places: list[Whole]) -> tuple[int, int, int, int] | None:
    """Numbers of four points that span a volume, or None."""
    origin, count = places[0], len(places)
    b = next((k for k in range(count) if places[k] != origin), None)
    if b is None:
        return None
    c = next((k for k in range(count) if any(_normal(origin, places[b], places[k]))), None)
    if c is None:
        return None
    normal = _normal(origin, places[b], places[c])
    d = next((k for k in range(count) if _dot(normal, _minus(places[k], origin)) != 0), None)
    return None if d is None else (0, b, c, d)


def _faces_of(places: list[Whole]) -> list[tuple[int, int, int]] | None:
    """Triangles of the hull, or None where the points span no volume.

    Point by point: the faces that see it go, and their rim is joined to it. A point in a face's plane is not seen by
    it, so no triangle without area arises.
    """
    first = _first_four(places)
    if first is None:
        return None
    a, b, c, d = first
    if _dot(_normal(places[a], places[b], places[c]), _minus(places[d], places[a])) > 0:
        b, c = c, b
    planes: dict[tuple[int, int, int], tuple[Whole, int]] = {}

    def add(i: int, j: int, k: int) -> None:
        normal = _normal(places[i], places[j], places[k])
        planes[i, j, k] = normal, _dot(normal, places[i])

    for face in ((a, b, c), (a, d, b), (b, d, c), (c, d, a)):
        add(*face)
    for at, place in enumerate(places):
        seen = [face for face, (normal, offset) in planes.items() if _dot(normal, place) > offset]
        rim = {edge for i, j, k in seen for edge in ((i, j), (j, k), (k, i))}
        for face in seen:
            del planes[face]
        for i, j in rim:
            if (j, i) not in rim:
                add(i, j, at)
    return list(planes)


def _edges(faces: list[tuple[int, int, int]], places: list[Whole]) -> list[tuple[int, int]]:
    """Edges between two faces that are not of one plane, each once, in rising order."""
    opposite = {(i, j): k for a, b, c in faces for i, j, k in ((a, b, c), (b, c, a), (c, a, b))}
    found = []
    for (i, j), k in opposite.items():
        if i < j:
            normal = _normal(places[i], places[j], places[k])
            if _dot(normal, _minus(places[opposite[j, i]], places[i])) != 0:
                found.append((i, j))
    return sorted(found)

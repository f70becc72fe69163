"""The surface of a polytope as what a picture fills: triangles that are small enough to be put in order of depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pep.pit.geometry.hull import hull_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.scene.scene import Convex, Vector

Line = tuple["Vector", "Vector"]


@dataclass(frozen=True, slots=True)
class Piece:
    """A triangle of the surface, the way out of it, and which of its sides are edges of the body."""

    ring: tuple[Vector, Vector, Vector]
    normal: Vector
    edges: tuple[Line, ...]

    @property
    def middle(self) -> Vector:
        """Its centre."""
        x, y, z = (sum(numbers) / len(self.ring) for numbers in zip(*self.ring, strict=True))
        return x, y, z


def pieces_of(shape: Convex, size_m: float) -> tuple[Piece, ...]:
    """The flat parts of the surface, in pieces of about `size_m`; a rounding moves them outward."""
    hull = hull_of(shape.vertices_m)
    edges = {tuple(edge) for edge in hull.edges.tolist()}
    found: list[Piece] = []
    for face, outward in zip(hull.faces.tolist(), hull.normals.tolist(), strict=True):
        normal: Vector = (outward[0], outward[1], outward[2])
        moved = [_moved(hull.vertices[k].tolist(), normal, shape.radius_m) for k in face]
        real = [(min(i, j), max(i, j)) in edges for i, j in zip(face, (*face[1:], face[0]), strict=True)]
        found += [Piece(ring, normal, lines) for ring, lines in _cut(moved, real, size_m)]
    return tuple(found)


def rounded_edges_of(shape: Convex) -> tuple[Line, ...]:
    """The edges about which a rounding lies; none where there is none."""
    if not shape.radius_m > 0:
        return ()
    hull = hull_of(shape.vertices_m)
    corners: list[Vector] = [(x, y, z) for x, y, z in hull.vertices.tolist()]
    return tuple((corners[i], corners[j]) for i, j in hull.edges.tolist())


def _moved(point: Vector, way: Vector, by_m: float) -> Vector:
    x, y, z = (a + by_m * b for a, b in zip(point, way, strict=True))
    return x, y, z


def _cut(
    ring: list[Vector], real: list[bool], size_m: float
) -> Iterator[tuple[tuple[Vector, Vector, Vector], tuple[Line, ...]]]:
    """Halves of halves of a triangle, cut through the middle of the longest side until that is short enough."""
    lengths = [math.dist(ring[k], ring[(k + 1) % 3]) for k in range(3)]
    longest = max(range(3), key=lengths.__getitem__)
    a, b, c = (ring[(longest + k) % 3] for k in range(3))
    ab, bc, ca = (real[(longest + k) % 3] for k in range(3))
    if not lengths[longest] > size_m:
        sides = ((a, b, ab), (b, c, bc), (c, a, ca))
        yield (a, b, c), tuple((p, q) for p, q, drawn in sides if drawn)
        return
    middle = _moved(_moved((0.0, 0.0, 0.0), a, 0.5), b, 0.5)
    yield from _cut([a, middle, c], [ab, False, ca], size_m)
    yield from _cut([middle, b, c], [ab, bc, False], size_m)

"""Proof that capsules cover a mesh, and a bound on their excess over it; neither rests on samples.

Cover: a capsule is convex, so a triangle is inside it when its corners are. One that is in no single capsule is halved
along its longest side until each half is; what is covered is so by the corners of finitely many triangles, which
together are the mesh.

Excess: the surface of all capsules is tiled by patches, each inside a ball of stated radius about one of its points. No
point of a patch is farther from the mesh than that point and the radius together. Patches that could hold the farthest
one are halved until both bounds are near each other; one deep inside another capsule is no surface of them all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.robot.model import LinkCapsule

HALVINGS: Final = 40  # of a triangle's longest side: of a metre to below a picometre, in two dimensions to a micrometre
PIECES: Final = 4_000_000  # ours: triangles under way at once; a cover with some room needs far fewer
TOLD_M: Final = 2e-3  # ours: how near both bounds of the excess come to each other
ROUNDING_M: Final = 1e-9  # on every depth, so that no corner is covered by rounding
CHUNK: Final = 60_000  # ours: pairs of points and triangles at once, which a cache holds
SPREAD_M: Final = 0.01  # ours: between points of the mesh that stand for it at first
FINE_M: Final = 3e-4  # ours: radius of a patch from which on its distance from the triangles is taken
LOOKS: Final = 16  # ours: patches in each round whose distance from the triangles is taken anyhow
FACES: Final = 6  # of a cube
FACE_CELLS: Final = 4  # along each side of the six faces about a ball, to begin with
RING_CELLS: Final = 16  # about a cylinder, to begin with
PATCHES: Final = 200_000  # ours: patches under way at once

Line: TypeAlias = "tuple[Floats, Floats, float]"
"""Both ends of a capsule's axis and its radius, metre."""


def lines_of(capsules: Sequence[LinkCapsule]) -> list[Line]:
    """The capsules as arrays."""
    return [(np.array(c.a_m), np.array(c.b_m), c.radius_m) for c in capsules]


def depths(points: Floats, line: Line) -> Floats:
    """Depth (n,), metre, of points (n, 3) in a capsule, below 0 outside."""
    a, b, radius = line
    way = b - a
    length = float(way @ way)
    along = np.clip((points - a) @ way / length, 0, 1) if length > 0 else np.zeros(len(points))
    off = points - a - along[:, None] * way
    return np.asarray(radius - np.sqrt(np.einsum("ij,ij->i", off, off)))


def uncovered(triangles: Floats, lines: Sequence[Line]) -> int:
    """Number of pieces of triangles (n, 3, 3) of which no cover was proven; 0 is a proof of cover."""
    left = triangles
    for _ in range(HALVINGS):
        inside = np.zeros(len(left), dtype=bool)
        corners = np.zeros((len(left), 3), dtype=bool)
        for line in lines:
            within = depths(left.reshape(-1, 3), line).reshape(-1, 3) >= ROUNDING_M
            inside |= within.all(axis=1)
            corners |= within
        if not corners.all():  # a corner in no capsule: there is no cover to prove
            return int((~corners.all(axis=1)).sum())
        left = left[~inside]
        if not len(left) or len(left) > PIECES:
            return len(left)
        left = _halved(left)
    return len(left)


def _halved(triangles: Floats) -> Floats:
    """Each triangle as two, cut from the middle of its longest side."""
    sides = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
    first = sides.argmax(axis=1)
    row = np.arange(len(triangles))
    a, b, c = (triangles[row, (first + k) % 3] for k in range(3))
    middle = 0.5 * (a + b)
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


@dataclass(frozen=True, slots=True)
class Excess:
    """Distance of the farthest point of the capsules' surface from the mesh: at least and at most so much, metre."""

    least_m: float
    most_m: float


def excess_of(triangles: Floats, lines: Sequence[Line]) -> Excess:
    """Bounds of the excess of all capsules over a mesh."""
    mesh = _Mesh(triangles, _spread(triangles))
    least, most = 0.0, 0.0
    for number, line in enumerate(lines):
        others = [other for k, other in enumerate(lines) if k != number]
        for patches in (_ball(0), _ball(1), _tube()):
            low, high = _farthest(mesh, line, others, patches, at_least=least)
            least, most = max(least, low), max(most, high)
    return Excess(least, most)


@dataclass(frozen=True, slots=True)
class _Mesh:
    """Triangles (n, 3, 3) of a mesh, and points (m, 3) all over it."""

    triangles: Floats
    points: Floats


def _spread(triangles: Floats) -> Floats:
    """Corners of the triangles, cut until no side is longer than `SPREAD_M`."""
    done, left = [], triangles
    while len(left):
        long = np.linalg.norm(left - np.roll(left, -1, axis=1), axis=2).max(axis=1) > SPREAD_M
        done.append(left[~long].reshape(-1, 3))
        left = _halved(left[long]) if long.any() else left[:0]
    return np.unique(np.concatenate(done), axis=0)


@dataclass(frozen=True, slots=True)
class _Patches:
    """Cells of one surface of a capsule.

    Attributes:
        end: the ball's end of the axis, or None for the tube.
        face: shape (n,): face of the cube about the ball.
        middle, half: shape (n, 2): of each cell, in the surface's own two numbers.
    """

    end: int | None
    face: NDArray[np.intp]
    middle: Floats
    half: Floats


def _ball(end: int) -> _Patches:
    edge = (np.arange(FACE_CELLS) + 0.5) * 2 / FACE_CELLS - 1
    u, v = np.meshgrid(edge, edge)
    cells = np.stack([u.ravel(), v.ravel()], axis=1)
    face = np.repeat(np.arange(FACES), len(cells))
    return _Patches(end, face, np.tile(cells, (FACES, 1)), np.full((len(face), 2), 1 / FACE_CELLS))


def _tube() -> _Patches:
    turn = (np.arange(RING_CELLS) + 0.5) * 2 * math.pi / RING_CELLS
    along = (np.arange(RING_CELLS) + 0.5) / RING_CELLS
    u, v = np.meshgrid(turn, along)
    cells = np.stack([u.ravel(), v.ravel()], axis=1)
    half = np.tile([math.pi / RING_CELLS, 0.5 / RING_CELLS], (len(cells), 1))
    return _Patches(None, np.zeros(len(cells), dtype=np.intp), cells, half)


def _placed(line: Line, patches: _Patches) -> tuple[Floats, Floats]:
    """Middle point (n, 3) of each patch, and the radius (n,) of a ball about it that holds the patch."""
    a, b, radius = line
    if patches.end is not None:
        axis, sign = patches.face % 3, np.where(patches.face < FACES / 2, 1.0, -1.0)
        way = np.empty((len(axis), 3))
        row = np.arange(len(axis))
        way[row, axis] = sign
        way[row, (axis + 1) % 3], way[row, (axis + 2) % 3] = patches.middle[:, 0], patches.middle[:, 1]
        way /= np.linalg.norm(way, axis=1)[:, None]
        # From the cube onto the ball inside it no distance grows.
        return (a, b)[patches.end] + radius * way, radius * np.hypot(patches.half[:, 0], patches.half[:, 1])
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length if length > 0 else np.array([0.0, 0.0, 1.0])
    side = np.eye(3)[int(np.abs(along).argmin())]
    x = np.cross(along, side)
    x /= np.linalg.norm(x)
    y = np.cross(along, x)
    turn = patches.middle[:, 0]
    out = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y
    points = a + patches.middle[:, 1, None] * (b - a) + radius * out
    return points, np.hypot(radius * patches.half[:, 0], length * patches.half[:, 1])


def _farthest(
    mesh: _Mesh, line: Line, others: Sequence[Line], patches: _Patches, *, at_least: float
) -> tuple[float, float]:
    """Distance from the mesh, at least and at most, of the farthest point of a surface outside other capsules."""
    least, most = at_least, 0.0
    while len(patches.face):
        points, reach = _placed(line, patches)
        depth = np.full(len(points), -np.inf)
        for other in (*others, line) if patches.end is not None else others:
            depth = np.maximum(depth, depths(points, other))
        shown = depth < reach  # else all of the patch is inside
        patches, points, reach, depth = _taken(patches, shown), points[shown], reach[shown], depth[shown]
        if not len(points):
            break
        off = _from_points(points, mesh.points)  # never too small
        outside = np.flatnonzero(depth <= ROUNDING_M)
        first = outside[off[outside].argsort()[-LOOKS:]]
        fine = np.flatnonzero(reach < FINE_M)
        exact = np.union1d(first, fine[off[fine] + reach[fine] > least + TOLD_M])
        off[exact] = distances(points[exact], mesh.triangles)
        least = max([least, *off[first].tolist()])
        settled = off + reach <= least + TOLD_M
        most = max([most, *(off + reach)[settled].tolist()])
        patches = _taken(patches, ~settled)
        if len(patches.face) > PATCHES:
            return least, max([most, *(off + reach)[~settled].tolist()])
        patches = _quartered(patches)
    return least, most


def _from_points(points: Floats, others: Floats) -> Floats:
    """Distance (n,) of each point (n, 3) from the nearest of others (m, 3)."""
    rows = max(1, CHUNK // len(others))
    square = np.einsum("mi,mi->m", others, others)
    found = [(square - 2 * (points[k : k + rows] @ others.T)).min(axis=1) for k in range(0, len(points), rows)]
    own = np.einsum("ni,ni->n", points, points)
    return np.asarray(np.sqrt(np.maximum(own + np.concatenate(found), 0)))


def _taken(patches: _Patches, which: NDArray[np.bool_]) -> _Patches:
    return _Patches(patches.end, patches.face[which], patches.middle[which], patches.half[which])


def _quartered(patches: _Patches) -> _Patches:
    half = 0.5 * patches.half
    middles = [patches.middle + half * (u, v) for u in (-1, 1) for v in (-1, 1)]
    return _Patches(patches.end, np.tile(patches.face, 4), np.concatenate(middles), np.tile(half, (4, 1)))


def distances(points: Floats, triangles: Floats) -> Floats:
    """Distance (n,) of each point (n, 3) from the nearest of the triangles (m, 3, 3)."""
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(ab, ac)
    area = np.linalg.norm(normal, axis=1)
    flat = area > 0
    normal[flat] /= area[flat, None]
    rows = max(1, CHUNK // max(1, len(triangles)))
    found = [_distances(points[k : k + rows], triangles, a, normal) for k in range(0, len(points), rows)]
    return np.concatenate(found) if found else np.zeros(0)


def _distances(points: Floats, triangles: Floats, a: Floats, normal: Floats) -> Floats:
    height = points @ normal.T - np.einsum("mi,mi->m", a, normal)
    over = np.ones(height.shape, dtype=bool)
    edges = np.full(height.shape, np.inf)
    for k in range(3):
        start, end = triangles[:, k], triangles[:, (k + 1) % 3]
        edge = end - start
        length = np.einsum("mi,mi->m", edge, edge)
        inward = np.cross(normal, edge)
        over &= points @ inward.T - np.einsum("mi,mi->m", start, inward) >= 0
        # Squared distance from an edge, by its foot.
        projected = points @ edge.T - np.einsum("mi,mi->m", start, edge)
        along = np.clip(projected / np.where(length > 0, length, 1.0), 0, 1)
        square = (
            np.einsum("ni,ni->n", points, points)[:, None]
            - 2 * (points @ start.T)
            + np.einsum("mi,mi->m", start, start)
            - 2 * along * projected
            + along**2 * length
        )
        edges = np.minimum(edges, np.maximum(square, 0))
    # A point over no triangle's inside has its nearest one on an edge.
    return np.asarray(np.minimum(np.where(over, np.abs(height), np.inf).min(axis=1), np.sqrt(edges.min(axis=1))))

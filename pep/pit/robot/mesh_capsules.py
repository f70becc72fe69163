"""Capsules around a mesh: few, small, and proven to hold all of it.

The mesh is cut across one direction into slabs; every slab gets the smallest capsule that a search finds. The cuts are
those with the least volume in all; of those numbers of capsules whose volume is near the least, the one with the least
excess is taken. What the search finds is not believed: the radius is the distance of the farthest corner with some
room, and the cover is proven (`mesh_cover`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import ModelError
from pep.pit.robot.enclosing_capsule import capsule_along, volume_m3
from pep.pit.robot.mesh_cover import TOLD_M, Excess, depths, excess_of, uncovered

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.robot.mesh_cover import Line

CAPSULES_MOST: Final = 3  # ours: for one mesh
SLABS: Final = 10  # ours: places at which it may be cut
OVERLAP_M: Final = 0.001  # ours: of neighbouring slabs, so that the proof of cover soon ends
ROOM_M: Final = 0.0005  # FIT: every point of the mesh is at least so deep in a capsule
GRID_M: Final = 1e-4  # ends and radii are written in tenths of a millimetre
SPARE: Final = 0.1  # ours: so much more volume than the least is taken for a lower excess
COARSE_CELLS: Final = 16  # ours: the same for one capsule of many
CELLS: Final = 40  # ours: points along each edge of a box whose share in capsules is counted
TRIES: Final = 32  # ours: changed capsules in each round of the search
SUPPORTS: Final = 300  # ours: directions whose farthest corners the search looks at
DIGITS: Final = 4  # of a number on the grid
STEP: Final = 0.3  # of the radius: the first changes
STARTS: Final = 3  # ours: a search that stood still begins again with large changes
SHRINK: Final = 0.8  # of the changes after a round without a better one
LEAST_STEP_M: Final = 2e-5  # ours: a fifth of the grid
SEED: Final = 20231  # ours: the same capsules every time


@dataclass(frozen=True, slots=True)
class Enclosure:
    """Capsules that are proven to hold all of a mesh, and their excess over it."""

    lines: tuple[Line, ...]
    excess: Excess


def enclosed(triangles: Floats, name: str, *, most: int = CAPSULES_MOST) -> Enclosure:
    """Capsules around the triangles (n, 3, 3).

    Args:
        triangles: of a closed mesh, metre.
        name: in a refusal.
        most: capsules.

    Raises:
        ModelError: the cover was not proven.
    """
    plans = [_Plan(triangles, way, most) for way in _ways(triangles)]
    tried = []
    for count in range(1, most + 1):
        slabs = min(plans, key=lambda plan: plan.volume_m3(count)).slabs(count)
        lines = tuple(_smallest(points) for points in slabs)
        tried.append((_volume_m3(lines, plans[0].way, -math.inf, math.inf, cells=CELLS), lines))
    enough = (1 + SPARE) * min(volume for volume, _ in tried)
    good = [Enclosure(lines, excess_of(triangles, lines)) for volume, lines in tried if volume <= enough]
    best = min(good, key=lambda each: (round(each.excess.most_m / TOLD_M), len(each.lines)))
    if uncovered(triangles, best.lines):
        raise ModelError("PHYSICS_FAULT", f"{name}: no proof that capsules cover it; export its convex hull")
    return best


def _ways(triangles: Floats) -> list[Floats]:
    """Directions across which the mesh may be cut: of the frame, and the principal ones of its corners."""
    points = triangles.reshape(-1, 3)
    _, _, principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return [*np.eye(3), principal[0]]


class _Plan:
    """Best cuts of a mesh in one direction, by the volumes of capsules that are found at once."""

    def __init__(self, triangles: Floats, way: Floats, most: int) -> None:
        heights = triangles @ way
        self._edges = np.linspace(heights.min(), heights.max(), SLABS + 1)
        self.way, self._triangles, self._heights = way, triangles, heights
        volumes = np.full((SLABS + 1, SLABS + 1), math.inf)
        for low in range(SLABS):
            for high in range(low + 1, SLABS + 1):
                line = min(_first(self._between(low, high), way), key=volume_m3)
                # What reaches beyond a cut is in its neighbour.
                floor = self._edges[low] if low else -math.inf
                ceiling = self._edges[high] if high < SLABS else math.inf
                volumes[low, high] = _volume_m3((line,), way, floor, ceiling, cells=COARSE_CELLS)
        # Least volume of so many capsules up to each edge, and the edge before.
        least = np.full((most + 1, SLABS + 1), math.inf)
        least[0, 0] = 0.0
        self._before = np.zeros((most + 1, SLABS + 1), dtype=int)
        for count in range(1, most + 1):
            sums = least[count - 1][:, None] + volumes
            least[count], self._before[count] = sums.min(axis=0), sums.argmin(axis=0)
        self._least = least[:, -1]

    def volume_m3(self, count: int) -> float:
        """Sum of the volumes of so many capsules."""
        return float(self._least[count])

    def slabs(self, count: int) -> list[Floats]:
        """Corners (n, 3) of the mesh in each slab."""
        found, high = [], SLABS
        for left in range(count, 0, -1):
            low = int(self._before[left, high])
            found.append(self._between(low, high))
            high = low
        return found[::-1]

    def _between(self, low: int, high: int) -> Floats:
        """Corners (n, 3) of all parts of the triangles between two planes, with some overlap."""
        floor = -math.inf if low == 0 else self._edges[low] - OVERLAP_M / 2
        ceiling = math.inf if high == SLABS else self._edges[high] + OVERLAP_M / 2
        kept = [self._triangles[(self._heights >= floor) & (self._heights <= ceiling)]]
        for plane in (floor, ceiling):
            if not math.isfinite(plane):
                continue
            for k in range(3):
                start, end = self._heights[:, k], self._heights[:, (k + 1) % 3]
                cut = (start < plane) != (end < plane)
                share = ((plane - start[cut]) / (end[cut] - start[cut]))[:, None]
                one, other = self._triangles[cut, k], self._triangles[cut, (k + 1) % 3]
                kept.append(one + share * (other - one))
        return np.unique(np.concatenate([each.reshape(-1, 3) for each in kept]), axis=0)


def _volume_m3(lines: tuple[Line, ...], way: Floats, floor: float, ceiling: float, *, cells: int) -> float:
    """Volume of the union of capsules between two planes, by points spread evenly over their box."""
    low = np.min([np.minimum(a, b) - radius for a, b, radius in lines], axis=0)
    high = np.max([np.maximum(a, b) + radius for a, b, radius in lines], axis=0)
    steps = [(np.arange(cells) + 0.5) / cells * (top - bottom) + bottom for bottom, top in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 3)
    heights = points @ way
    points = points[(heights >= floor) & (heights <= ceiling)]
    inside = np.max([depths(points, line) for line in lines], axis=0) >= 0
    return float(inside.sum() / cells**3 * np.prod(high - low))


def _first(points: Floats, way: Floats) -> list[Line]:
    """Capsules about the points along their principal ways and along this one."""
    _, principal = np.linalg.eigh(np.cov(points.T))
    return [capsule_along(points, each) for each in (way, principal[:, -1])]


def _smallest(points: Floats) -> Line:
    """The smallest capsule that a search finds about the points, in numbers as they are written."""
    a, b, radius = min((capsule_along(points, way) for way in np.linalg.eigh(np.cov(points.T))[1].T), key=volume_m3)
    rng = np.random.default_rng(SEED)
    ways = rng.normal(size=(SUPPORTS, 3))
    outer = points[np.unique((points @ ways.T).argmax(axis=0))]  # the others are inside their hull, or nearly so
    best = np.concatenate([a, b])
    least = float(_volumes(best[None], outer)[0])
    for _ in range(STARTS):
        step = STEP * radius
        while step >= LEAST_STEP_M:
            changes = rng.normal(size=(TRIES, 6))  # both ends
            # Most is won where the ends go along the axis.
            along = (best[3:] - best[:3]) / max(float(np.linalg.norm(best[3:] - best[:3])), LEAST_STEP_M)
            half = TRIES // 2
            changes[:half] = np.concatenate([changes[:half, :1] * along, changes[:half, 1:2] * along], axis=1)
            tried = best + step * changes
            volumes = _volumes(tried, outer)
            first = int(volumes.argmin())
            if volumes[first] < least:
                best, least = tried[first], float(volumes[first])
            else:
                step *= SHRINK
    a, b = (np.round(end / GRID_M) * GRID_M for end in (best[:3], best[3:]))
    needed = -float(depths(points, (a, b, 0.0)).min()) + ROOM_M
    return np.round(a, DIGITS), np.round(b, DIGITS), round(math.ceil(needed / GRID_M) * GRID_M, DIGITS)


def _volumes(ends: Floats, points: Floats) -> Floats:
    """Volume (n,) of the capsule about the points for each axis (n, 6)."""
    a, way = ends[:, :3], ends[:, 3:] - ends[:, :3]
    length = np.einsum("ni,ni->n", way, way)
    off = points[None] - a[:, None]
    along = np.einsum("npi,ni->np", off, way) / np.maximum(length, np.finfo(float).tiny)[:, None]
    off = off - np.clip(along, 0, 1)[:, :, None] * way[:, None]
    radius = np.sqrt(np.einsum("npi,npi->np", off, off).max(axis=1))
    return np.asarray(math.pi * radius**2 * (np.sqrt(length) + 4 / 3 * radius))  # of a capsule

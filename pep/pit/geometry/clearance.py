"""Distance of convex cores, exact and in bulk, and the bound that a separating direction proves for an interval.

Everything is a core (point, segment, box, polytope, half-space) with a radius. Signed clearance is the core distance
less the radii; when cores meet it is minus the radii, and never a penetration depth, on which engines differ.

The bound does not trust the distance: for *any* unit direction n, two bodies are at least as far apart as their extents
along n say. A closest-point routine that errs makes the bound weaker, never wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.geometry.hull import Hull

ROUNDING_M: Final = 1e-9  # far above float64 rounding of metre-sized sums (1e-15), far below anything that matters
PARALLEL: Final = 1e-12  # relative: below it two segments count as parallel and any point of the overlap serves
TINY: Final = 1e-30  # squared length (m^2) below which a segment is a point
CORNERS: Final = 6  # faces of a box: where the distance along a segment changes its formula
APART_M: Final = 1e-9  # cores nearer than this give no direction
BESIDE_M: Final = 1e-12  # a foot this near to a face is on it: between two triangles of one plane rounding loses none
AT_ONCE: Final = 2**17  # pairs of an axis and an edge that are computed together; bounds the memory
NONE: Final = -1  # no polytope


@dataclass(frozen=True, slots=True)
class Cores:
    """Obstacles, one row per pair.

    Attributes:
        is_segment, is_box: which rows are; of the others those with a hull are polytopes, and the rest planes.
        a: first end, centre, or a plane's outward normal (the body must keep a·p <= offset).
        b: second end of a segment.
        axes, half: of a box, its axes as columns.
        offset: of a plane.
        hull: of a polytope, its place among `hulls`; -1 for anything else.
        hulls: all polytopes.
    """

    is_segment: NDArray[np.bool_]
    is_box: NDArray[np.bool_]
    a: Floats
    b: Floats
    axes: Floats
    half: Floats
    offset: Floats
    hull: NDArray[np.intp]
    hulls: tuple[Hull, ...] = ()

    @property
    def is_plane(self) -> NDArray[np.bool_]:
        """True for rows that are planes: all others have a thickness, and cores that meet count as 0 apart."""
        return np.asarray(~(self.is_segment | self.is_box | (self.hull != NONE)))

    def polytopes(self) -> Iterator[tuple[Hull, NDArray[np.intp]]]:
        """Each polytope among the rows, with its rows."""
        if self.hulls:
            for which in np.unique(self.hull[self.hull != NONE]).tolist():
                yield self.hulls[which], np.flatnonzero(self.hull == which)

    def take(self, rows: NDArray[np.intp]) -> Cores:
        """These rows."""
        return Cores(
            self.is_segment[rows],
            self.is_box[rows],
            self.a[rows],
            self.b[rows],
            self.axes[rows],
            self.half[rows],
            self.offset[rows],
            self.hull[rows],
            self.hulls,
        )


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def segment_segment(p: Floats, q: Floats, c: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Closest points of segments pq and cd, row by row: (on pq, on cd), each of shape (n, 3)."""
    u, v, w = q - p, d - c, p - c
    a, e, f, g, b = _dot(u, u), _dot(v, v), _dot(v, w), _dot(u, w), _dot(u, v)
    det = a * e - b * b
    safe_a, safe_e = np.where(a > TINY, a, 1), np.where(e > TINY, e, 1)
    skew = det > PARALLEL * a * e
    s = np.where(skew, (b * f - g * e) / np.where(skew, det, 1), 0)
    s = np.where(e > TINY, np.clip(s, 0, 1), np.clip(-g / safe_a, 0, 1))
    s = np.where(a > TINY, s, 0)
    t = np.where(e > TINY, (b * s + f) / safe_e, 0)
    # Where t leaves the second segment its end is the closest, and s follows.
    beyond = (t < 0) | (t > 1)
    t = np.clip(t, 0, 1)
    s = np.where(beyond & (a > TINY), np.clip((b * t - g) / safe_a, 0, 1), s)
    return p + s[:, None] * u, c + t[:, None] * v


def segment_box(p: Floats, q: Floats, center: Floats, axes: Floats, half: Floats) -> tuple[Floats, Floats]:
    """Closest points of segments pq and boxes, row by row.

    Half the squared distance along the segment is convex and piecewise quadratic with breaks where a face plane is
    crossed; its derivative is linear in between, so its root is found exactly.
    """
    start = np.einsum("nij,ni->nj", axes, p - center)
    way = np.einsum("nij,ni->nj", axes, q - p)
    moving = np.abs(way) > TINY
    safe = np.where(moving, way, 1)
    breaks = np.concatenate([(half - start) / safe, (-half - start) / safe], axis=1)
    breaks = np.where(np.concatenate([moving, moving], axis=1), np.clip(breaks, 0, 1), 0)
    knots = np.sort(np.concatenate([np.zeros((len(p), 1)), breaks, np.ones((len(p), 1))], axis=1), axis=1)
    points = start[:, None] + knots[:, :, None] * way[:, None]
    outside = points - np.clip(points, -half[:, None], half[:, None])
    slope = _dot(outside, way[:, None])
    # First knot from which the slope is no longer negative; the minimum lies between it and the one before.
    first = np.where((slope >= 0).any(axis=1), (slope >= 0).argmax(axis=1), CORNERS + 1)
    last = np.maximum(first - 1, 0)
    row = np.arange(len(p))
    low, high, slope_low, slope_high = knots[row, last], knots[row, first], slope[row, last], slope[row, first]
    rise = slope_high - slope_low
    bends = rise > 0
    t = np.where(bends, low - slope_low * (high - low) / np.where(bends, rise, 1), low)
    t = np.clip(np.where((first == 0) | (slope_high < 0), high, t), 0, 1)
    inner = start + t[:, None] * way
    nearest = np.clip(inner, -half, half)
    return p + t[:, None] * (q - p), center + np.einsum("nij,nj->ni", axes, nearest)


def segment_hull(p: Floats, q: Floats, hull: Hull) -> tuple[Floats, Floats]:
    """Closest points of segments pq, (n, 3) each, and one polytope; one point twice where they meet.

    A segment that is not somewhere behind all faces is nearest with an end above a face, or to an edge.
    """
    above_p, above_q = (np.einsum("ni,fi->nf", end, hull.normals) - hull.offsets for end in (p, q))
    # 1. The part of the segment that is behind all faces, in shares of it.
    fall = above_p - above_q
    share = above_p / np.where(fall == 0, 1, fall)
    first = np.where(fall > 0, share, np.where((fall == 0) & (above_p > 0), np.inf, 0)).max(axis=1, initial=0)
    last = np.where(fall < 0, share, 1).min(axis=1, initial=1)
    inside = p + np.minimum(first, 1)[:, None] * (q - p)
    # 2. The nearest edge.
    count, edges = len(p), len(hull.edges)
    near, far = hull.vertices[hull.edges[:, 0]], hull.vertices[hull.edges[:, 1]]
    on_axis, on_edge = segment_segment(
        np.repeat(p, edges, axis=0), np.repeat(q, edges, axis=0), np.tile(near, (count, 1)), np.tile(far, (count, 1))
    )
    gap = on_axis - on_edge
    square = _dot(gap, gap).reshape(count, edges)
    chosen = square.argmin(axis=1)
    row = np.arange(count)
    on_body, on_core = on_axis.reshape(count, edges, 3)[row, chosen], on_edge.reshape(count, edges, 3)[row, chosen]
    best = np.sqrt(square[row, chosen])
    # 3. Or the face that an end is nearest above.
    for end, above in ((p, above_p), (q, above_q)):
        beside = np.einsum("ni,fki->nfk", end, hull.sides) - hull.side_offsets
        height = np.where((above > 0) & (beside <= BESIDE_M).all(axis=2), above, np.inf)
        face = height.argmin(axis=1)
        lower = height[row, face] < best
        best = np.where(lower, height[row, face], best)
        foot = end - above[row, face, None] * hull.normals[face]
        on_body, on_core = np.where(lower[:, None], end, on_body), np.where(lower[:, None], foot, on_core)
    meets = (first <= last)[:, None]
    return np.where(meets, inside, on_body), np.where(meets, inside, on_core)


def core_distance(ends: Floats, cores: Cores) -> tuple[Floats, Floats]:
    """Distance of each body axis (n, 2, 3) to its obstacle's core, and the unit direction from obstacle to body.

    Where cores meet the distance is 0 and the direction is 0. Beyond a plane the distance is negative: a plane has no
    thickness.
    """
    n = len(ends)
    on_body, on_core = np.zeros((n, 3)), np.zeros((n, 3))
    segment, box = cores.is_segment, cores.is_box
    if segment.any():
        on_body[segment], on_core[segment] = segment_segment(
            ends[segment, 0], ends[segment, 1], cores.a[segment], cores.b[segment]
        )
    if box.any():
        on_body[box], on_core[box] = segment_box(
            ends[box, 0], ends[box, 1], cores.a[box], cores.axes[box], cores.half[box]
        )
    for hull, rows in cores.polytopes():
        for part in np.array_split(rows, 1 + len(rows) * len(hull.edges) // AT_ONCE):
            on_body[part], on_core[part] = segment_hull(ends[part, 0], ends[part, 1], hull)
    gap = on_body - on_core
    distance = np.sqrt(_dot(gap, gap))
    apart = distance > APART_M
    direction = np.where(apart[:, None], gap / np.where(apart, distance, 1)[:, None], 0)
    for hull, rows in cores.polytopes():
        # What the direction proves is the distance: an error in a hull's faces can only bring it nearer.
        between = _dot(ends[rows], direction[rows, None]).min(axis=1) - _reach(hull, direction[rows])
        apart_by = np.where(apart[rows], np.minimum(between, distance[rows]), 0)
        clear = apart_by > APART_M
        distance[rows] = np.where(clear, apart_by, 0)
        direction[rows] = np.where(clear[:, None], direction[rows], 0)
    plane = cores.is_plane
    if plane.any():
        direction[plane] = -cores.a[plane]
        distance[plane] = (cores.offset[plane, None] - _dot(ends[plane], cores.a[plane, None])).min(axis=1)
    return distance, direction


def _reach(hull: Hull, direction: Floats) -> Floats:
    """Largest extent of the polytope along each of these directions."""
    return np.asarray(np.einsum("ni,vi->nv", direction, hull.vertices).max(axis=1))

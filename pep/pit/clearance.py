"""Distance of convex cores, exact and in bulk, and what a separating direction proves for a whole path interval.

Everything is a core (point, segment, box, half-space) with a radius. Signed clearance is the core distance less the
radii; when cores meet it is minus the radii, and never a penetration depth, on which engines differ.

The bound does not trust the distance: for *any* unit direction n, two bodies are at least as far apart as their extents
along n say. A closest-point routine that errs makes the bound weaker, never wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.motion import Floats

ROUNDING_M: Final = 1e-9  # far above float64 rounding of metre-sized sums (1e-15), far below anything that matters
PARALLEL: Final = 1e-12  # relative: below it two segments count as parallel and any point of the overlap serves
TINY: Final = 1e-30  # squared length (m^2) below which a segment is a point
CORNERS: Final = 6  # faces of a box: where the distance along a segment changes its formula
APART_M: Final = 1e-9  # cores nearer than this give no direction


@dataclass(frozen=True, slots=True)
class Cores:
    """Obstacles, one row per pair.

    Attributes:
        is_segment, is_box: which rows are; the others are planes.
        a: first end, centre, or a plane's outward normal (the body must keep a·p <= offset).
        b: second end of a segment.
        axes, half: of a box, its axes as columns.
        offset: of a plane.
    """

    is_segment: NDArray[np.bool_]
    is_box: NDArray[np.bool_]
    a: Floats
    b: Floats
    axes: Floats
    half: Floats
    offset: Floats

    def and_then(self, more: Cores) -> Cores:
        """These rows, then those."""
        return Cores(
            np.concatenate([self.is_segment, more.is_segment]),
            np.concatenate([self.is_box, more.is_box]),
            np.concatenate([self.a, more.a]),
            np.concatenate([self.b, more.b]),
            np.concatenate([self.axes, more.axes]),
            np.concatenate([self.half, more.half]),
            np.concatenate([self.offset, more.offset]),
        )

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
    gap = on_body - on_core
    distance = np.sqrt(_dot(gap, gap))
    apart = distance > APART_M
    direction = np.where(apart[:, None], gap / np.where(apart, distance, 1)[:, None], 0)
    plane = ~(segment | box)
    if plane.any():
        direction[plane] = -cores.a[plane]
        distance[plane] = (cores.offset[plane, None] - _dot(ends[plane], cores.a[plane, None])).min(axis=1)
    return distance, direction


def interval_clearance(ends: Floats, direction: Floats, cores: Cores, *, radii: Floats, sag: Floats) -> Floats:
    """A clearance that holds on the whole interval, row by row, in metres.

    Args:
        ends: body axes (3, n, 2, 3) at the start, the middle and the end of the interval.
        direction: unit vectors (n, 3), from obstacle to body; a zero row proves nothing.
        cores: the obstacles.
        radii: sum of both radii.
        sag: how far an axis can leave the chord between neighbouring ones of the three nodes.

    Every point of the axis stays within `sag` of a convex combination of node points (chord lemma, capsules are
    convex), so its extent along the direction is at least the least of the six projections, less `sag`.
    """
    ahead = _dot(ends, direction[None, :, None]).min(axis=(0, 2))
    bound = ahead - _support(cores, direction) - radii - sag - ROUNDING_M
    proven = _dot(direction, direction) > 0.5  # a unit vector, or zero
    solid = cores.is_segment | cores.is_box
    return np.asarray(np.where(solid, np.where(proven, np.maximum(bound, -radii), -radii), bound))


def _support(cores: Cores, direction: Floats) -> Floats:
    """Largest extent of each core along the direction; for a plane, of the forbidden side."""
    segment = np.maximum(_dot(cores.a, direction), _dot(cores.b, direction))
    box = _dot(cores.a, direction) + _dot(np.abs(np.einsum("nij,ni->nj", cores.axes, direction)), cores.half)
    return np.asarray(np.where(cores.is_segment, segment, np.where(cores.is_box, box, -cores.offset)))

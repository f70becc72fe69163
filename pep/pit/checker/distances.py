"""Segments, boxes and polytopes: shortest way between two bodies, and extent of a body along a direction.

The bound of a row holds for any direction, so an error here makes it weaker, never wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

Vec = tuple[float, float, float]
Mat = tuple[Vec, Vec, Vec]  # rows

ORIGIN: Final[Vec] = (0.0, 0.0, 0.0)
TINY_M2: Final = 1e-30  # squared length below which a segment is a point
STEPS: Final = 200  # of a search; each comes nearer, and a handful is usual
NEARER: Final = 1e-12  # relative: a step that would bring less is rounding
MEETING_M2: Final = 1e-18  # squared: bodies nearer than 1e-9 m meet, and have no direction
PARALLEL: Final = 1e-14  # squared sine below which the interior formula is rounding alone; the ends then decide


@dataclass(frozen=True, slots=True)
class Segment:
    """All points between `a` and `b`, metre; with a radius it is a capsule, with a = b a ball."""

    a: Vec
    b: Vec


@dataclass(frozen=True, slots=True)
class CheckerBox:
    """A box: centre, half edges (metre) and its own axes as rows."""

    center: Vec
    half: Vec
    axes: Mat


@dataclass(frozen=True, slots=True)
class Face:
    """Plane with the bodies behind it: normal . p <= offset."""

    normal: Vec
    offset: float


@dataclass(frozen=True, slots=True)
class Polytope:
    """The convex hull of these corners, metre; with a radius it is rounded."""

    corners: tuple[Vec, ...]


Core = Segment | CheckerBox | Polytope | Face


def dot(a: Vec, b: Vec) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Vec, b: Vec) -> Vec:
    """First less second."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def plus(a: Vec, b: Vec, share: float = 1.0) -> Vec:
    """First plus a share of the second."""
    return (a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2])


def cross(a: Vec, b: Vec) -> Vec:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def length(a: Vec) -> float:
    """Euclidean norm."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def turned(m: Mat, v: Vec) -> Vec:
    """The matrix times the vector."""
    return (dot(m[0], v), dot(m[1], v), dot(m[2], v))


def product(m: Mat, n: Mat) -> Mat:
    """The matrix product."""
    (a, b, c), (d, e, f), (g, h, i) = n
    x, y, z = (
        (r[0] * a + r[1] * d + r[2] * g, r[0] * b + r[1] * e + r[2] * h, r[0] * c + r[1] * f + r[2] * i) for r in m
    )
    return (x, y, z)


def transposed(m: Mat) -> Mat:
    """Rows as columns."""
    (a, b, c), (d, e, f), (g, h, i) = m
    return ((a, d, g), (b, e, h), (c, f, i))


def _to_point(a: Vec, b: Vec, point: Vec) -> Vec:
    """From the point to the nearest point of segment ab."""
    way = minus(b, a)
    square = dot(way, way)
    start = minus(a, point)
    if square <= TINY_M2:
        return start
    share = -dot(start, way) / square
    return plus(start, way, min(1.0, max(0.0, share)))


def between_segments(a: Vec, b: Vec, c: Vec, d: Vec) -> Vec:
    """The shortest vector from segment cd to segment ab.

    It joins two interior points, where it is square to both, or it starts or ends at one of the four ends.
    """
    u, v, w = minus(b, a), minus(d, c), minus(a, c)
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    if vv <= TINY_M2:
        return _to_point(a, b, c)
    if uu <= TINY_M2:
        x, y, z = _to_point(c, d, a)
        return (-x, -y, -z)
    uw, vw = dot(u, w), dot(v, w)
    sine = uu * vv - uv * uv
    if sine > PARALLEL * uu * vv:
        s, t = (uv * vw - vv * uw) / sine, (uu * vw - uv * uw) / sine
        if 0 <= s <= 1 and 0 <= t <= 1:
            return plus(plus(w, u, s), v, -t)
    first, second = _to_point(c, d, a), _to_point(c, d, b)
    ways = (
        _to_point(a, b, c),
        _to_point(a, b, d),
        (-first[0], -first[1], -first[2]),
        (-second[0], -second[1], -second[2]),
    )
    return min(ways, key=lambda way: dot(way, way))


def _beyond(x: float, half: float) -> float:
    """Signed distance of x outside [-half, half]."""
    return x - half if x > half else x + half if x < -half else 0.0


def from_block(a: Vec, b: Vec, block: CheckerBox) -> Vec:
    """The shortest vector from the box to segment ab.

    Along the segment the squared distance is convex and, between two crossings of face planes, a parabola: the first
    piece whose lowest point lies in or before it has the minimum.
    """
    start = turned(block.axes, minus(a, block.center))
    way = turned(block.axes, minus(b, a))
    half = block.half
    cuts = {0.0, 1.0}
    for x, d, h in zip(start, way, half, strict=True):
        if d:
            cuts.update(t for t in ((h - x) / d, (-h - x) / d) if 0 < t < 1)
    knots = sorted(cuts)
    best = 1.0
    for low, high in pairwise(knots):
        middle = 0.5 * (low + high)
        slope = square = 0.0
        for x, d, h in zip(start, way, half, strict=True):
            out = _beyond(x + middle * d, h)
            if out:
                slope += d * (out - middle * d)
                square += d * d
        lowest = -slope / square if square > TINY_M2 else low
        if lowest <= high:
            best = max(low, lowest)
            break
    gap = tuple(_beyond(x + best * d, h) for x, d, h in zip(start, way, half, strict=True))
    return turned(transposed(block.axes), (gap[0], gap[1], gap[2]))


def from_polytope(a: Vec, b: Vec, body: Polytope) -> Vec:
    """Shortest vector from the polytope to segment ab; None where they meet.

    The differences of their points are a polytope of their own, of which the point nearest the origin is sought: from
    the nearest one of at most four corners to the corner that lies farthest against it, until none lies farther.
    """
    near = minus(a, body.corners[0])
    held = [near]
    for _ in range(STEPS):
        square = dot(near, near)
        if square <= MEETING_M2:
            return ORIGIN
        end = a if dot(a, near) <= dot(b, near) else b
        ahead = minus(end, max(body.corners, key=lambda corner: dot(corner, near)))
        if square - dot(near, ahead) <= NEARER * square or ahead in held:
            return near
        held = [*held, ahead]
        near, held = _nearest_of(held)
    return near


def _nearest_of(corners: list[Vec]) -> tuple[Vec, list[Vec]]:
    """Nearest point to the origin in the hull of at most four points, and its fewest points."""
    best, square, kept = corners[0], math.inf, corners
    for some in range(1, 2 ** len(corners)):
        chosen = [corner for k, corner in enumerate(corners) if some >> k & 1]
        found = _foot(chosen)
        if found is not None and dot(found, found) < square:
            best, square, kept = found, dot(found, found), chosen
    return best, kept


def _foot(corners: list[Vec]) -> Vec | None:
    """The origin's foot on the point, line, plane or space of these points; None where it lies outside them."""
    first, *others = corners
    ways = [minus(other, first) for other in others]
    match ways:
        case []:
            return first
        case [u]:
            uu = dot(u, u)
            if not uu > TINY_M2:
                return None
            s = -dot(first, u) / uu
            return plus(first, u, s) if 0 <= s <= 1 else None
        case [u, v]:
            uu, vv, uv, fu, fv = dot(u, u), dot(v, v), dot(u, v), dot(first, u), dot(first, v)
            sine = uu * vv - uv * uv
            if not sine > PARALLEL * uu * vv:
                return None
            s, t = (uv * fv - vv * fu) / sine, (uv * fu - uu * fv) / sine
            if not (s >= 0 and t >= 0 and s + t <= 1):
                return None
            normal = cross(u, v)  # along it the foot is exact however flat the triangle
            share = dot(first, normal) / dot(normal, normal)
            return (share * normal[0], share * normal[1], share * normal[2])
        case [u, v, w]:
            volume = dot(u, cross(v, w))
            if not volume * volume > PARALLEL * dot(u, u) * dot(v, v) * dot(w, w):
                return None
            x, y, z = first
            away = (-x, -y, -z)
            s, t, r = (dot(away, cross(p, q)) / volume for p, q in ((v, w), (w, u), (u, v)))
            return ORIGIN if min(s, t, r) >= 0 and s + t + r <= 1 else None
        case _:
            return None


def reach(core: Segment | CheckerBox | Polytope, n: Vec) -> float:
    """Extent of the core along the unit vector n."""
    match core:
        case Segment(a, b):
            return max(dot(a, n), dot(b, n))
        case CheckerBox(center, half, (x, y, z)):
            return dot(center, n) + half[0] * abs(dot(x, n)) + half[1] * abs(dot(y, n)) + half[2] * abs(dot(z, n))
        case Polytope(corners):
            return max(dot(corner, n) for corner in corners)

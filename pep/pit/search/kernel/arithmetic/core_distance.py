"""Distance of a body's axis to one obstacle's core, and its direction (formulae: `pep.pit.geometry.clearance`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from pep.pit.base.pair_columns import (
    AXES,
    BEHIND,
    BESIDE,
    BOX,
    EDGE,
    EDGES,
    FACES,
    FIRST_ROW,
    HALF,
    NORMAL,
    OFFSET,
    PLANE,
    POLYTOPE,
    RADII,
    SEGMENT,
    SIDES,
    VERTEX,
    VERTICES,
    A,
    B,
)
from pep.pit.geometry.clearance import APART_M, BESIDE_M, PARALLEL, ROUNDING_M, TINY
from pep.pit.search.kernel.arithmetic.compilation import lent

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats

Gap: TypeAlias = tuple[float, float, float, float]
"""Distance of two cores, metre, and the unit direction from obstacle to body; 0 where they meet."""


@lent
def _clip(x: float, low: float, high: float) -> float:
    return low if x < low else (min(x, high))


@lent
def _directed(x: float, y: float, z: float) -> Gap:
    """Gap between two points that are this vector apart."""
    distance = math.sqrt(x * x + y * y + z * z)
    if not distance > APART_M:
        return distance, 0.0, 0.0, 0.0
    return distance, x / distance, y / distance, z / distance


@lent
def _nearest(
    px: float, py: float, pz: float, ux: float, uy: float, uz: float,
    cx: float, cy: float, cz: float, vx: float, vy: float, vz: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Shortest way between two segments, from the one at c along v to the one at p along u."""
    wx, wy, wz = px - cx, py - cy, pz - cz
    a, e = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    g, f = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    b = ux * vx + uy * vy + uz * vz
    s = t = 0.0
    if e > TINY:
        det = a * e - b * b
        if det > PARALLEL * a * e:
            s = _clip((b * f - g * e) / det, 0.0, 1.0)
        t = (b * s + f) / e
        if t < 0.0 or t > 1.0:
            t = _clip(t, 0.0, 1.0)
            if a > TINY:
                s = _clip((b * t - g) / a, 0.0, 1.0)
    elif a > TINY:
        s = _clip(-g / a, 0.0, 1.0)
    return wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz


@lent
def _segment(ends: Floats, at: int, body: int, numbers: Floats, pair: int) -> Gap:
    """Gap between the axis and an obstacle's segment."""
    px, py, pz = ends[at, body, 0, 0], ends[at, body, 0, 1], ends[at, body, 0, 2]
    ux, uy, uz = ends[at, body, 1, 0] - px, ends[at, body, 1, 1] - py, ends[at, body, 1, 2] - pz
    cx, cy, cz = numbers[pair, A], numbers[pair, A + 1], numbers[pair, A + 2]
    vx, vy, vz = numbers[pair, B] - cx, numbers[pair, B + 1] - cy, numbers[pair, B + 2] - cz
    x, y, z = _nearest(px, py, pz, ux, uy, uz, cx, cy, cz, vx, vy, vz)
    return _directed(x, y, z)


@lent
def _out(x: float, half: float) -> float:
    """Distance outside of [-half, half], with its sign."""
    return x - half if x > half else (x + half if x < -half else 0.0)


@lent
def _box(ends: Floats, at: int, body: int, numbers: Floats, pair: int) -> Gap:
    """Gap between the axis and an obstacle's box: the exact root of a piecewise linear derivative."""
    m = AXES
    px = ends[at, body, 0, 0] - numbers[pair, A]
    py = ends[at, body, 0, 1] - numbers[pair, A + 1]
    pz = ends[at, body, 0, 2] - numbers[pair, A + 2]
    ux = ends[at, body, 1, 0] - ends[at, body, 0, 0]
    uy = ends[at, body, 1, 1] - ends[at, body, 0, 1]
    uz = ends[at, body, 1, 2] - ends[at, body, 0, 2]
    # In the box's own axes: start and way of the axis.
    sx = numbers[pair, m] * px + numbers[pair, m + 3] * py + numbers[pair, m + 6] * pz
    sy = numbers[pair, m + 1] * px + numbers[pair, m + 4] * py + numbers[pair, m + 7] * pz
    sz = numbers[pair, m + 2] * px + numbers[pair, m + 5] * py + numbers[pair, m + 8] * pz
    wx = numbers[pair, m] * ux + numbers[pair, m + 3] * uy + numbers[pair, m + 6] * uz
    wy = numbers[pair, m + 1] * ux + numbers[pair, m + 4] * uy + numbers[pair, m + 7] * uz
    wz = numbers[pair, m + 2] * ux + numbers[pair, m + 5] * uy + numbers[pair, m + 8] * uz
    hx, hy, hz = numbers[pair, HALF], numbers[pair, HALF + 1], numbers[pair, HALF + 2]
    t = 0.0
    slope_low = _out(sx, hx) * wx + _out(sy, hy) * wy + _out(sz, hz) * wz
    if slope_low < 0.0:
        t = 1.0
        slope_high = _out(sx + wx, hx) * wx + _out(sy + wy, hy) * wy + _out(sz + wz, hz) * wz
        if slope_high > 0.0:
            low, high = 0.0, 1.0
            for face in range(6):  # where the derivative bends: the rest has its root on one straight piece
                start, way, half = (sx, wx, hx) if face < 2 else ((sy, wy, hy) if face < 4 else (sz, wz, hz))
                if abs(way) > TINY:
                    x = ((half if face & 1 == 0 else -half) - start) / way
                    if low < x < high:
                        slope = _out(sx + x * wx, hx) * wx + _out(sy + x * wy, hy) * wy + _out(sz + x * wz, hz) * wz
                        if slope < 0.0:
                            low, slope_low = x, slope
                        else:
                            high, slope_high = x, slope
            rise = slope_high - slope_low
            t = _clip(low - slope_low * (high - low) / rise, low, high) if rise > 0.0 else low
    dx, dy, dz = _out(sx + t * wx, hx), _out(sy + t * wy, hy), _out(sz + t * wz, hz)
    return _directed(
        numbers[pair, m] * dx + numbers[pair, m + 1] * dy + numbers[pair, m + 2] * dz,
        numbers[pair, m + 3] * dx + numbers[pair, m + 4] * dy + numbers[pair, m + 5] * dz,
        numbers[pair, m + 6] * dx + numbers[pair, m + 7] * dy + numbers[pair, m + 8] * dz,
    )


@lent
def plane_gap(ends: Floats, at: int, body: int, numbers: Floats, pair: int) -> Gap:
    """Gap between the axis and a plane's forbidden side; negative beyond it."""
    nx, ny, nz = numbers[pair, A], numbers[pair, A + 1], numbers[pair, A + 2]
    first = ends[at, body, 0, 0] * nx + ends[at, body, 0, 1] * ny + ends[at, body, 0, 2] * nz
    second = ends[at, body, 1, 0] * nx + ends[at, body, 1, 1] * ny + ends[at, body, 1, 2] * nz
    return numbers[pair, OFFSET] - max(first, second), -nx, -ny, -nz


@lent
def ahead(ends: Floats, at: int, body: int, x: float, y: float, z: float) -> float:
    """Least extent of the axis along a direction."""
    first = ends[at, body, 0, 0] * x + ends[at, body, 0, 1] * y + ends[at, body, 0, 2] * z
    return min(first, ends[at, body, 1, 0] * x + ends[at, body, 1, 1] * y + ends[at, body, 1, 2] * z)


@lent
def _along(numbers: Floats, row: int, column: int, x: float, y: float, z: float) -> float:
    """Extent of a point along the vector in three columns of a row."""
    return numbers[row, column] * x + numbers[row, column + 1] * y + numbers[row, column + 2] * z


@lent
def _reach(numbers: Floats, pair: int, x: float, y: float, z: float) -> float:
    """Largest extent of a polytope along a direction."""
    first = int(numbers[pair, FIRST_ROW])
    most = _along(numbers, first, VERTEX, x, y, z)
    for row in range(first + 1, first + int(numbers[pair, VERTICES])):
        most = max(most, _along(numbers, row, VERTEX, x, y, z))
    return most


@lent
def _pierces(numbers: Floats, pair: int, px: float, py: float, pz: float, qx: float, qy: float, qz: float) -> bool:
    """True where a part of the segment is behind all faces of the polytope."""
    first, low, high = int(numbers[pair, FIRST_ROW]), 0.0, 1.0
    for row in range(first, first + int(numbers[pair, FACES])):
        start = _along(numbers, row, NORMAL, px, py, pz) - numbers[row, BEHIND]
        end = _along(numbers, row, NORMAL, qx, qy, qz) - numbers[row, BEHIND]
        if start > end:
            low = max(low, start / (start - end))
        elif start < end:
            high = min(high, start / (start - end))
        elif start > 0.0:
            return False
    return low <= high


@lent
def _above(numbers: Floats, row: int, x: float, y: float, z: float) -> float:
    """Height of a point above a face; infinite where its foot is not on it, or it is behind."""
    height = _along(numbers, row, NORMAL, x, y, z) - numbers[row, BEHIND]
    if not height > 0.0:
        return math.inf
    for side in range(3):
        if not _along(numbers, row, SIDES + 3 * side, x, y, z) - numbers[row, BESIDE + side] <= BESIDE_M:
            return math.inf
    return height


@lent
def _polytope(ends: Floats, at: int, body: int, numbers: Floats, pair: int) -> Gap:
    """Gap between the axis and an obstacle's polytope (derivation: `pep.pit.geometry.clearance.segment_hull`)."""
    px, py, pz = ends[at, body, 0, 0], ends[at, body, 0, 1], ends[at, body, 0, 2]
    qx, qy, qz = ends[at, body, 1, 0], ends[at, body, 1, 1], ends[at, body, 1, 2]
    if _pierces(numbers, pair, px, py, pz, qx, qy, qz):
        return 0.0, 0.0, 0.0, 0.0
    first, best, dx, dy, dz = int(numbers[pair, FIRST_ROW]), math.inf, 0.0, 0.0, 0.0
    for row in range(first, first + int(numbers[pair, EDGES])):
        cx, cy, cz = numbers[row, EDGE], numbers[row, EDGE + 1], numbers[row, EDGE + 2]
        vx, vy, vz = numbers[row, EDGE + 3] - cx, numbers[row, EDGE + 4] - cy, numbers[row, EDGE + 5] - cz
        x, y, z = _nearest(px, py, pz, qx - px, qy - py, qz - pz, cx, cy, cz, vx, vy, vz)
        if x * x + y * y + z * z < best:
            best, dx, dy, dz = x * x + y * y + z * z, x, y, z
    best = math.sqrt(best)
    for row in range(first, first + int(numbers[pair, FACES])):
        height = min(_above(numbers, row, px, py, pz), _above(numbers, row, qx, qy, qz))
        if height < best:
            best = height
            dx, dy, dz = (
                height * numbers[row, NORMAL],
                height * numbers[row, NORMAL + 1],
                height * numbers[row, NORMAL + 2],
            )
    distance, x, y, z = _directed(dx, dy, dz)
    # What the direction proves is the distance: an error in a face can only bring it nearer.
    apart = min(ahead(ends, at, body, x, y, z) - _reach(numbers, pair, x, y, z), distance)
    return (apart, x, y, z) if apart > APART_M else (0.0, 0.0, 0.0, 0.0)


@lent
def core_gap(ends: Floats, at: int, body: int, numbers: Floats, pair: int, shape: int) -> Gap:
    """Gap between a body's axis, as placed in row `at`, and a pair's core."""
    if shape == SEGMENT:
        return _segment(ends, at, body, numbers, pair)
    if shape == BOX:
        return _box(ends, at, body, numbers, pair)
    if shape == POLYTOPE:
        return _polytope(ends, at, body, numbers, pair)
    return plane_gap(ends, at, body, numbers, pair)


@lent
def support(numbers: Floats, pair: int, shape: int, x: float, y: float, z: float) -> float:
    """Largest extent of the core along a direction; for a plane, of the forbidden side."""
    if shape == SEGMENT:
        first = numbers[pair, A] * x + numbers[pair, A + 1] * y + numbers[pair, A + 2] * z
        return max(first, numbers[pair, B] * x + numbers[pair, B + 1] * y + numbers[pair, B + 2] * z)
    if shape == BOX:
        extent = numbers[pair, A] * x + numbers[pair, A + 1] * y + numbers[pair, A + 2] * z
        for axis in range(3):
            m = AXES + axis
            along = numbers[pair, m] * x + numbers[pair, m + 3] * y + numbers[pair, m + 6] * z
            extent += abs(along) * numbers[pair, HALF + axis]
        return extent
    if shape == POLYTOPE:
        return _reach(numbers, pair, x, y, z)
    return -numbers[pair, OFFSET]


@lent
def interval_gap(
    ends: Floats,
    low: int,
    mid: int,
    high: int,
    body: int,
    numbers: Floats,
    pair: int,
    shape: int,
    gap: Gap,
    sag: float,
) -> float:
    """Clearance that holds on the whole interval (proof: `pep.pit.geometry.clearance.interval_clearance`).

    Args:
        ends: bodies as placed; low, mid, high: the rows of the interval's three nodes.
        body, numbers, pair, shape: the pair.
        gap: in the middle.
        sag: distance of the axis from the chord between neighbouring nodes, at most.
    """
    _, x, y, z = gap
    radii = numbers[pair, RADII]
    if shape != PLANE and not x * x + y * y + z * z > 0.5:  # a unit vector, or zero
        return -radii
    least = min(ahead(ends, low, body, x, y, z), ahead(ends, mid, body, x, y, z), ahead(ends, high, body, x, y, z))
    bound = least - support(numbers, pair, shape, x, y, z) - radii - sag - ROUNDING_M
    return bound if shape == PLANE else max(bound, -radii)

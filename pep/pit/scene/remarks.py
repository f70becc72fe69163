"""Remarks on a cell that has its form, and may still not be what its author measured.

Nothing is refused for them: a shelf may well hang above the base. Each names a thing and what looks odd about it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from typing import TYPE_CHECKING, Final, assert_never

import coal
import numpy as np

from pep.pit.geometry.coal_shapes import core_of
from pep.pit.geometry.shape import Box, Capsule, Convex, Sphere
from pep.pit.geometry.solids import rotation_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.base.motion import Floats
    from pep.pit.geometry.shape import Shape
    from pep.pit.scene.scene import Scene, Thing

TOUCHING_M: Final = 0.005  # ours: what lies on a table may be measured so far into it
FLANGE: Final = Capsule((0.0, 0.0, 0.05), (0.0, 0.0, 0.10), 0.05)  # m; ours: inside of every base
"""Column over the base that every supported arm fills (UR3e: 0.128 m across, 0.152 m high). Ours."""
SLAB_M: Final = 0.5  # ours: sides of a table's top
THIN_M: Final = 0.15  # ours: height of a table's top, its frame included
LARGE_M: Final = 5.0  # ours: longest side that a thing near an arm has
SMALL_M: Final = 0.001  # ours: longest side of a thing that nobody surveys


class RemarkCode(StrEnum):
    """Kind of a remark."""

    OBJECTS_OVERLAP = "OBJECTS_OVERLAP"
    BASE_IN_OBJECT = "BASE_IN_OBJECT"
    TABLE_ABOVE_BASE = "TABLE_ABOVE_BASE"
    ZONE_OUTSIDE_WORKSPACE = "ZONE_OUTSIDE_WORKSPACE"
    NOT_METRES = "NOT_METRES"


@dataclass(frozen=True, slots=True)
class Remark:
    """One thing, and what looks odd about it."""

    code: RemarkCode
    name: str
    what: str


def remarks(scene: Scene) -> Iterator[Remark]:
    """Remarks on the objects, zones and workspace of a scene whose shapes are sound."""
    for thing in scene.objects:
        yield from _sized(thing.id, thing.shape)
        yield from _at_the_base(thing)
    for zone in scene.zones:
        yield from _sized(zone.id, zone.shape)
        low, high = bounds_of(zone.shape)
        area = scene.workspace
        if area is not None and not ((high > area.low_m) & (low < area.high_m)).all():
            yield Remark(RemarkCode.ZONE_OUTSIDE_WORKSPACE, zone.id, "no part of it is in the workspace")
    if scene.workspace is not None:
        side = float(np.max(np.subtract(scene.workspace.high_m, scene.workspace.low_m)))
        if side > 2 * LARGE_M:
            yield Remark(RemarkCode.NOT_METRES, "workspace", f"{side:g} m long")
    for one, other in combinations(scene.objects, 2):
        depth_m = -_gap_m(one.shape, other.shape)
        if depth_m > TOUCHING_M:
            what = f"{_mm(depth_m):.0f} mm inside {other.id[:48]!r}"
            yield Remark(RemarkCode.OBJECTS_OVERLAP, one.id, what)


def _sized(name: str, shape: Shape) -> Iterator[Remark]:
    low, high = bounds_of(shape)
    side = float((high - low).max())
    if side > LARGE_M:
        yield Remark(RemarkCode.NOT_METRES, name, f"{side:g} m long")
    if side < SMALL_M:
        yield Remark(RemarkCode.NOT_METRES, name, f"only {_mm(side):.3g} mm long")


def _at_the_base(thing: Thing) -> Iterator[Remark]:
    if _gap_m(thing.shape, FLANGE) < -TOUCHING_M:
        yield Remark(RemarkCode.BASE_IN_OBJECT, thing.id, "the robot's base, at (0, 0, 0), is inside it")
        return
    low, high = bounds_of(thing.shape)
    size = high - low
    if thing.kind == "rigid" and min(size[0], size[1]) >= SLAB_M and size[2] <= THIN_M and high[2] > TOUCHING_M:
        what = f"flat as a table, and its top is {_mm(high[2]):.0f} mm above the base's plane"
        yield Remark(RemarkCode.TABLE_ABOVE_BASE, thing.id, what)


def bounds_of(shape: Shape) -> tuple[Floats, Floats]:
    """Low and high corner of the upright box around a shape."""
    match shape:
        case Box(center, half, quaternion):
            reach = np.abs(rotation_of(quaternion)) @ np.array(half)
            return np.array(center) - reach, np.array(center) + reach
        case Capsule(a, b, radius):
            points = np.array([a, b])
        case Sphere(center, radius):
            points = np.array([center])
        case Convex(vertices, radius):
            points = np.array(vertices)
        case _:
            assert_never(shape)
    return points.min(axis=0) - radius, points.max(axis=0) + radius


def _mm(metres: float) -> float:
    return 1e3 * metres  # mm to the metre


def _gap_m(one: Shape, other: Shape) -> float:
    """Distance of two shapes, or minus about how deep one is in the other."""
    (low, high), (low_, high_) = bounds_of(one), bounds_of(other)
    if ((low > high_) | (low_ > high)).any():
        return 0.0
    a, b = core_of(one), core_of(other)
    found = coal.DistanceResult()
    far = coal.distance(
        a.built(),
        coal.Transform3s(a.pose.rotation, a.pose.translation),
        b.built(),
        coal.Transform3s(b.pose.rotation, b.pose.translation),
        coal.DistanceRequest(),
        found,
    )
    return float(far) - a.radius - b.radius

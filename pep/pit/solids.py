"""Shapes as the rows of cores that distances are asked of: one row per pair, with the radius beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

import numpy as np

from pep.pit.clearance import NONE, Cores
from pep.pit.hull import hull_of
from pep.pit.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.hull import Hull
    from pep.pit.motion import Floats
    from pep.pit.scene import Scene, Shape, Vector
    from pep.pit.shape import Quaternion

Plane = tuple["Vector", float]
"""Outward normal and offset."""


def cores_of(shapes: Sequence[Shape]) -> tuple[Cores, Floats]:
    """Core and radius of each shape."""
    n = len(shapes)
    is_box = np.zeros(n, dtype=bool)
    a, b, half, radius = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    axes = np.tile(np.eye(3), (n, 1, 1))
    hull = np.full(n, NONE, dtype=np.intp)
    hulls: list[Hull] = []
    last: Shape | None = None
    for k, shape in enumerate(shapes):
        if shape is last:  # rows of one obstacle stand together
            is_box[k], a[k], b[k], half[k], axes[k], radius[k], hull[k] = (
                is_box[k - 1], a[k - 1], b[k - 1], half[k - 1], axes[k - 1], radius[k - 1], hull[k - 1],
            )  # fmt: skip
            continue
        last = shape
        match shape:
            case Capsule(start, end, r):
                a[k], b[k], radius[k] = start, end, r
            case Sphere(center, r):
                a[k], b[k], radius[k] = center, center, r
            case Box(center, extent, quaternion):
                is_box[k] = True
                a[k], b[k], half[k], axes[k] = center, center, extent, rotation_of(quaternion)
            case Convex(vertices, r):
                hull[k], radius[k] = len(hulls), r
                hulls.append(hull_of(vertices))
            case _:
                assert_never(shape)
    is_segment = ~is_box & (hull == NONE)
    return Cores(is_segment, is_box, a, b, axes, half, np.zeros(n), hull, tuple(hulls)), radius


def rotation_of(quaternion: Quaternion) -> Floats:
    """Rotation matrix of a quaternion (w, x, y, z), which is normalised first."""
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def planes_of(scene: Scene) -> list[Plane]:
    """The workspace's six faces: (outward normal, offset)."""
    if scene.workspace is None:
        return []
    faces: list[Plane] = []
    for axis in range(3):
        unit = [0.0, 0.0, 0.0]
        unit[axis] = 1.0
        faces.append(((unit[0], unit[1], unit[2]), scene.workspace.high_m[axis]))
        faces.append(((-unit[0], -unit[1], -unit[2]), -scene.workspace.low_m[axis]))
    return faces


def with_planes(cores: Cores, radius: Floats, planes: list[Plane], each: int) -> tuple[Cores, Floats]:
    """The rows with `each` more rows of every plane behind them; a plane has no radius."""
    n = each * len(planes)
    normal = np.repeat(np.array([p[0] for p in planes]), each, axis=0)
    offset = np.repeat(np.array([p[1] for p in planes]), each)

    faces = Cores(
        np.zeros(n, dtype=bool),
        np.zeros(n, dtype=bool),
        normal,
        normal,
        np.zeros((n, 3, 3)),
        np.zeros((n, 3)),
        offset,
        np.full(n, NONE, dtype=np.intp),
    )
    return cores.and_then(faces), np.concatenate([radius, np.zeros(n)])

"""A scene in which capsules stand for polytopes, for who reckons with bounds and has none for these."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.robot.enclosing_capsule import capsule_around_points
from pep.pit.scene.scene import Capsule, Convex

if TYPE_CHECKING:
    from pep.pit.scene.scene import Scene, Shape


def enclosed(scene: Scene) -> Scene:
    """The scene with a capsule around each polytope: nothing in it is farther away."""
    return replace(
        scene,
        objects=tuple(replace(thing, shape=_capsule(thing.shape)) for thing in scene.objects),
        zones=tuple(replace(zone, shape=_capsule(zone.shape)) for zone in scene.zones),
    )


def _capsule(shape: Shape) -> Shape:
    if not isinstance(shape, Convex):
        return shape
    a, b, around = capsule_around_points(np.array(shape.vertices_m))
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return Capsule((ax, ay, az), (bx, by, bz), around + shape.radius_m)

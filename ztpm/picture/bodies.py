"""Bodies of a picture as shaded triangles: the surroundings, the deciding posture of the arm, its swept path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.picture.surface import COARSE, FINE, capsule, cut, normals_of, surface_of
from pep.pit.scene.scene import Box, Capsule, Convex

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.base.motion import Floats
    from pep.pit.picture.picture import Picture
    from pep.pit.scene.scene import Shape

CELL_M: Final = 0.12
"""Largest piece of a surface, so that a body on a table is drawn after the table."""
COLOURS: Final = {
    "base": "#5b6770",
    "arm": "#2f7fc1",
    "tool": "#1d4e79",
    "payload": "#8a5fbf",
    "person": "#e08a3c",
    "fragile": "#17a398",
    "rigid": "#b5b9bd",
    "zone": "#c0392b",
    "workspace": "#6b7783",
    "witness": "#d11149",
}
TONES: Final = {
    "head": 1.18,
    "neck": 1.12,
    "upper_arm": 0.86,
    "lower_arm": 0.8,
    "hand": 1.12,
    "thigh": 0.92,
    "shin": 0.86,
}
"""Brightness of a person's regions, so that arms are seen before the trunk; the others have the colour itself."""
GHOSTS: Final = 14
"""Postures of the swept path that are shown faintly."""
OPAQUE: Final = {"solid": 1.0, "end": 0.2, "ghost": 0.04, "zone": 0.14, "fragile": 0.75}
"""Opacity of a posture, and of a body by its kind; every other body is opaque."""
LIGHT: Final = np.array([0.35, -0.45, 0.82])
MARGIN_M: Final = 0.05
AROUND_M: Final = 0.30
"""Range of the surroundings around the arm that is shown; the rest is cut off."""


@dataclass(frozen=True, slots=True)
class Filled:
    """Triangles (n, 3, 3) with their outward normals (n, 3) and colours (n, 4).

    A colour is red, green, blue and opacity.
    """

    triangles: Floats
    normals: Floats
    colours: Floats


def _filled(triangles: Floats, colour: str, opaque: float, *, tone: float = 1.0) -> Filled:
    """Triangles shaded by their angle to the light."""
    normals = normals_of(triangles)
    bright = 0.5 + 0.5 * normals @ (LIGHT / np.linalg.norm(LIGHT))
    rgb = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    light = np.clip(2.0 * bright[:, None] - 1.1, 0, 1) * 0.3
    shade = np.minimum(rgb * tone, 1.0) * (0.62 + 0.38 * bright[:, None])
    colours = shade + light * (1.0 - shade)
    return Filled(triangles, normals, np.column_stack([colours, np.full(len(triangles), opaque)]))


def bodies_of(shown: Picture) -> Iterator[Filled]:
    """Everything that has a body: the surroundings, the arm's deciding posture, and its swept path."""
    for body in shown.bodies:
        tone = TONES.get(body.name.partition("/")[2], 1.0) if body.kind == "person" else 1.0
        for triangles in triangles_of(body.shape, CELL_M / 2):
            yield _filled(triangles, COLOURS[body.kind], OPAQUE.get(body.kind, 1.0), tone=tone)
    last = len(shown.postures) - 1
    decides = shown.witnesses[0].posture if shown.witnesses else last
    looks = {round(k * last / GHOSTS): "ghost" for k in range(1, GHOSTS)} | {0: "end", last: "end", decides: "solid"}
    for row, posture in enumerate(shown.postures):
        for part, kind in zip(posture.parts, shown.parts, strict=True):
            if row in looks and (kind != "base" or row == decides):
                around = COARSE if looks[row] == "ghost" else FINE
                triangles = capsule(part.a_m, part.b_m, part.radius_m, CELL_M / 2, around=around)
                yield _filled(triangles, COLOURS[kind], OPAQUE[looks[row]])


def triangles_of(shape: Shape, size_m: float) -> Iterator[Floats]:
    """Surfaces of a shape, each (n, 3, 3), in triangles about `size_m` long."""
    if isinstance(shape, Box | Convex):
        surface = surface_of(shape)
        yield cut(surface.triangles, size_m)
        for a, b in surface.rods.tolist():
            yield capsule(tuple(a), tuple(b), surface.radius_m, size_m)
    elif isinstance(shape, Capsule):
        yield capsule(shape.a_m, shape.b_m, shape.radius_m, size_m)
    else:
        yield capsule(shape.center_m, shape.center_m, shape.radius_m, size_m)


def extent(shown: Picture, *, whole: bool) -> tuple[Floats, Floats]:
    """Low and high corner of the picture: the arm wherever it goes, and some of its surroundings.

    Args:
        shown: everything.
        whole: people are shown from head to foot. Of a cell, where nothing moves, everything is shown.
    """
    balls = [(end, part.radius_m) for p in shown.postures for part in p.parts for end in (part.a_m, part.b_m)]
    balls += [(end, 0.0) for w in shown.witnesses for end in (w.near.on_part_m, w.near.on_thing_m)]
    arm = [np.array(end) + sign * radius for end, radius in balls for sign in (-1, 1)]
    around = [
        (body.kind, points.reshape(-1, 3)) for body in shown.bodies for points in triangles_of(body.shape, math.inf)
    ]
    arm = arm or [point for _, points in around for point in points] or [np.full(3, -AROUND_M), np.full(3, AROUND_M)]
    if shown.assessment is None:
        every = np.concatenate([np.array(arm), *(points for _, points in around), np.array(shown.workspace or arm[:1])])
        return every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
    low, high = np.min(arm, axis=0) - AROUND_M, np.max(arm, axis=0) + AROUND_M
    some = [points if whole and kind == "person" else np.clip(points, low, high) for kind, points in around]
    every = np.concatenate([np.array(arm), *some])
    return every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M

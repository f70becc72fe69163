"""Outlines of a picture's bodies in one direction of view, farthest first: what any drawing library can fill.

Everything is projected along parallel lines: the outline of a capsule is then exactly a stadium.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.pit.scene.scene import Box, Capsule, Convex
from ztpm.pit_picture import CELL_M, COLOURS, FACES, corners
from ztpm.pit_picture_faces import pieces_of, rounded_edges_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.scene.scene import Shape, Sphere, Vector
    from ztpm.picture.postures import Part
    from ztpm.pit_picture import Body, Picture

GHOSTS: Final = 14
"""Postures of the swept path that are shown faintly."""
LOOKS: Final = {"solid": (1.0, 0.9), "end": (0.30, 0.55), "ghost": (0.07, 0.10)}
"""How opaque the arm and its outline are: where it decides, at start and end, and in between."""
ARC: Final = 20
"""Corners of half a round end."""
Colour = tuple[float, float, float, float]
"""Red, green, blue and how opaque, each from 0 to 1."""
CLEAR: Final[Colour] = (0.0, 0.0, 0.0, 0.0)
Flat = tuple[float, float]
"""Right and up in a view, metres."""
LIGHT: Final = (0.35, -0.45, 0.82)
MARGIN_M: Final = 0.12
FAINT: Final = 0.6
"""What is less opaque than this is not made to look round."""
AROUND_M: Final = 0.30
"""How much of what stands around the arm is shown: what is farther out is cut off."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A direction of view: unit vectors to the right, up, and towards the eye."""

    right: Vector
    up: Vector
    eye: Vector

    @staticmethod
    def at(azimuth_rad: float, elevation_rad: float) -> Camera:
        """The eye far away in that direction, x to the right when azimuth is -90 degrees."""
        ca, sa = math.cos(azimuth_rad), math.sin(azimuth_rad)
        ce, se = math.cos(elevation_rad), math.sin(elevation_rad)
        return Camera((-sa, ca, 0.0), (-se * ca, -se * sa, ce), (ce * ca, ce * sa, se))

    def flat(self, point: Vector) -> Flat:
        """Right and up, metres."""
        return _dot(self.right, point), _dot(self.up, point)

    def depth(self, point: Vector) -> float:
        """Nearer to the eye is more."""
        return _dot(self.eye, point)


ABOVE: Final = Camera((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Patch:
    """One filled outline and how near it is."""

    depth: float
    outline: tuple[Flat, ...]
    fill: Colour
    edge: Colour


# --- where to look from ----------------------------------------------------------------------------------------------


def level(shown: Picture) -> Camera:
    """Level, across the line of the first witness, so that its gap is seen in full; else along y."""
    for witness in shown.witnesses:
        a, b = witness.near.on_part_m, witness.near.on_thing_m
        along = (b[0] - a[0], b[1] - a[1])
        if math.hypot(*along) > 0.02:
            azimuth = math.atan2(along[1], along[0]) - math.pi / 2
            # Of the two sides the one from which +x is on the right, as in the view from above.
            if -math.sin(azimuth) < 0:
                azimuth += math.pi
            return Camera.at(azimuth, 0.0)
    return Camera.at(-math.pi / 2, 0.0)


def aslant(side: Camera) -> Camera:
    """From above and to the side of a level view."""
    azimuth = math.atan2(side.eye[1], side.eye[0])
    return Camera.at(azimuth + 0.6, 0.5)


# --- outlines --------------------------------------------------------------------------------------------------------


def patches_of(shown: Picture, camera: Camera) -> Iterator[Patch]:
    """Everything that has a body, in no order yet."""
    for body in shown.bodies:
        yield from _body(body, camera)
    if not shown.postures:
        return
    last = len(shown.postures) - 1
    chosen = {round(k * last / GHOSTS) for k in range(1, GHOSTS)}
    witness = shown.witnesses[0].posture if shown.witnesses else last
    for row, posture in enumerate(shown.postures):
        look = "solid" if row == witness else "end" if row in (0, last) else "ghost" if row in chosen else None
        if look is None:
            continue
        for part, kind in zip(posture.parts, shown.parts, strict=True):
            if kind != "base" or row == witness:
                yield from _capsule(camera, (part.a_m, part.b_m), part.radius_m, COLOURS[kind], LOOKS[look])


def _body(body: Body, camera: Camera) -> Iterator[Patch]:
    colour = COLOURS[body.kind]
    look = {"zone": (0.14, 0.6), "person": (0.92, 0.8), "fragile": (0.75, 0.9)}.get(body.kind, (1.0, 0.8))
    shape = body.shape
    if isinstance(shape, Box):
        yield from _box(camera, shape, colour, look, cut=body.kind != "zone")
        return
    if isinstance(shape, Convex):
        yield from _polytope(camera, shape, colour, look, cut=body.kind != "zone")
        return
    yield from _capsule(camera, _ends(shape), shape.radius_m, colour, look)


def _ends(shape: Capsule | Sphere) -> tuple[Vector, Vector]:
    return (shape.a_m, shape.b_m) if isinstance(shape, Capsule) else (shape.center_m, shape.center_m)


def _capsule(
    camera: Camera, ends: tuple[Vector, Vector], radius: float, colour: str, look: tuple[float, float]
) -> Iterator[Patch]:
    """The outline, and inside it two lighter ones that make it look round."""
    a, b = (camera.flat(end) for end in ends)
    depth = max(camera.depth(end) for end in ends)
    rgb = rgb_of(colour)
    alpha, edge = look
    yield Patch(depth, _stadium(a, b, radius), (*rgb, alpha), (*_mix(rgb, 0.45, dark=True), edge))
    if alpha < FAINT:
        return
    for share, light in ((0.68, 0.16), (0.36, 0.34)):
        x, y = (lift * radius * (1.2 - share) for lift in (-0.22, 0.26))
        inner = _stadium((a[0] + x, a[1] + y), (b[0] + x, b[1] + y), radius * share)
        yield Patch(depth + 1e-6 * (1 - share), inner, (*_mix(rgb, light), alpha), CLEAR)


def _stadium(a: Flat, b: Flat, radius: float) -> tuple[Flat, ...]:
    """The convex hull of two discs."""
    towards = math.atan2(b[1] - a[1], b[0] - a[0])
    points = []
    for center, first in ((b, towards - math.pi / 2), (a, towards + math.pi / 2)):
        for k in range(ARC + 1):
            angle = first + math.pi * k / ARC
            points.append((center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle)))
    return tuple(points)


def _box(camera: Camera, box: Box, colour: str, look: tuple[float, float], *, cut: bool) -> Iterator[Patch]:
    """The faces that are turned to the eye, shaded by how they lie to the light."""
    at = corners(box)
    for face in FACES:
        p, q, _, s = (at[k] for k in face)
        normal = _unit(_cross(_minus(q, p), _minus(s, p)))
        outward = _minus(p, box.center_m)
        if _dot(normal, outward) < 0:
            normal = (-normal[0], -normal[1], -normal[2])
        if _dot(normal, camera.eye) <= 1e-9:
            continue
        fill, line = _shaded(colour, normal, look)
        across = max(1, math.ceil(math.dist(p, q) / CELL_M)) if cut else 1
        along = max(1, math.ceil(math.dist(p, s) / CELL_M)) if cut else 1
        for i in range(across):
            for j in range(along):
                piece = [_on(p, q, s, (i + u) / across, (j + v) / along) for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))]
                middle = _on(p, q, s, (i + 0.5) / across, (j + 0.5) / along)
                depth = camera.depth(middle) - 1e-3
                ring = tuple(camera.flat(corner) for corner in piece)
                yield Patch(depth, ring, fill, fill if cut else CLEAR)
                # The face's own edges, each with the piece that it borders.
                outer = (j == 0, i == across - 1, j == along - 1, i == 0)
                for k in (k for k in range(4) if outer[k]):
                    yield Patch(depth, (ring[k], ring[(k + 1) % 4]), CLEAR, line)


def _polytope(camera: Camera, shape: Convex, colour: str, look: tuple[float, float], *, cut: bool) -> Iterator[Patch]:
    """The same of a polytope; a rounding lies about its edges."""
    alpha, _ = look
    for a, b in rounded_edges_of(shape):
        yield from _capsule(camera, (a, b), shape.radius_m, colour, (alpha, 0.0))
    for piece in pieces_of(shape, CELL_M if cut else math.inf):
        if _dot(piece.normal, camera.eye) <= 1e-9:
            continue
        fill, line = _shaded(colour, piece.normal, look)
        depth = camera.depth(piece.middle) - 1e-3
        yield Patch(depth, tuple(camera.flat(corner) for corner in piece.ring), fill, fill if cut else CLEAR)
        for p, q in piece.edges:
            yield Patch(depth, (camera.flat(p), camera.flat(q)), CLEAR, line)


def _shaded(colour: str, normal: Vector, look: tuple[float, float]) -> tuple[Colour, Colour]:
    """What a face that lies so to the light is filled with, and its edges' colour."""
    alpha, edge = look
    rgb = rgb_of(colour)
    bright = 0.5 + 0.5 * _dot(normal, _unit(LIGHT))
    shade = _mix(rgb, 0.45 * bright) if bright > 0.5 else _mix(rgb, 0.25, dark=True)
    return (*shade, alpha), (*_mix(rgb, 0.35, dark=True), edge)


def frame(shown: Picture, camera: Camera, ratio: float, *, whole: bool) -> tuple[Flat, Flat]:
    """Corners of what is shown: the arm wherever it goes, the nearest points, and some of what stands around.

    Args:
        shown: everything.
        camera: the direction.
        ratio: width by height, which the corners get.
        whole: people are shown from head to foot.
    """
    points = [p for posture in shown.postures for part in posture.parts for p in _hull(part, camera)]
    points += [camera.flat(p) for w in shown.witnesses for p in (w.near.on_part_m, w.near.on_thing_m)]
    around = [
        (point, whole and body.kind == "person") for body in shown.bodies for point in outline(body.shape, camera)
    ]
    points = points or [point for point, _ in around] or [(-AROUND_M, -AROUND_M), (AROUND_M, AROUND_M)]
    low = (min(x for x, _ in points) - AROUND_M, min(y for _, y in points) - AROUND_M)
    high = (max(x for x, _ in points) + AROUND_M, max(y for _, y in points) + AROUND_M)
    for (x, y), wanted in around:
        points.append((x, y) if wanted else (min(max(x, low[0]), high[0]), min(max(y, low[1]), high[1])))
    x0, x1 = min(x for x, _ in points) - MARGIN_M, max(x for x, _ in points) + MARGIN_M
    y0, y1 = min(y for _, y in points) - MARGIN_M, max(y for _, y in points) + MARGIN_M
    wide, tall = max(x1 - x0, ratio * (y1 - y0)), max(y1 - y0, (x1 - x0) / ratio)
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    return (x - 0.5 * wide, y - 0.5 * tall), (x + 0.5 * wide, y + 0.5 * tall)


def _hull(part: Part, camera: Camera) -> tuple[Flat, ...]:
    return _stadium(camera.flat(part.a_m), camera.flat(part.b_m), part.radius_m)


def outline(shape: Shape, camera: Camera) -> list[Flat]:
    """The shape's outline in this view, or the corners that it is the hull of."""
    if isinstance(shape, Box):
        return [camera.flat(corner) for corner in corners(shape)]
    if isinstance(shape, Convex):
        flat = [camera.flat(vertex) for vertex in shape.vertices_m]
        r = shape.radius_m
        return [(x + u * r, y + v * r) for x, y in flat for u, v in ((-1, -1), (-1, 1), (1, -1), (1, 1))]
    a, b = (camera.flat(end) for end in _ends(shape))
    return list(_stadium(a, b, shape.radius_m))


# --- small geometry --------------------------------------------------------------------------------------------------


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _unit(a: Vector) -> Vector:
    length = math.sqrt(_dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


def _on(p: Vector, q: Vector, s: Vector, u: float, v: float) -> Vector:
    x, y, z = (p[d] + u * (q[d] - p[d]) + v * (s[d] - p[d]) for d in range(3))
    return x, y, z


def rgb_of(colour: str) -> tuple[float, float, float]:
    """Three numbers from 0 to 1 of a colour `#rrggbb`."""
    r, g, b = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return r, g, b


def _mix(rgb: tuple[float, float, float], share: float, *, dark: bool = False) -> tuple[float, float, float]:
    goal = 0.0 if dark else 1.0
    r, g, b = (c + share * (goal - c) for c in rgb)
    return r, g, b

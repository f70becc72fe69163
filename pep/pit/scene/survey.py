"""Signed cell file as parameters of the physics room: the objects of a person's word, and no others.

A file that is well formed can still contradict itself or the world. It is refused as a whole then: nobody can tell
which half of it its author meant.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np

from capabilities.statements import observation as wire
from capabilities.values.units import Unit, si
from pep.pit.base.errors import CellError, SceneError
from pep.pit.geometry.clearance import segment_hull
from pep.pit.geometry.hull import hull_of
from pep.pit.geometry.shape import shape_of
from pep.pit.scene.cell import CellParameters, Contact, Output, StaticObject, StaticZone
from pep.pit.scene.scene import Workspace

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from capabilities.statements.cell import Cell
    from capabilities.statements.observation import Point, Shape

CELL_REACH_UM: Final = 10_000_000  # 10 m, ours
"""No part of a cell is further from the base: beyond it is a wrong unit, not a thing."""
SURVEYED: Final = ("contacts", "objects", "outputs", "payload_kg", "tool", "workspace", "zones")
"""Members of `CellParameters` that only a signed cell file may state."""


class SurveyFault(StrEnum):
    """Reason why a well-formed, signed cell file is refused."""

    OUT_OF_REACH = "OUT_OF_REACH"
    BASE_OUTSIDE_WORKSPACE = "BASE_OUTSIDE_WORKSPACE"
    CONTACT_WITH_NOTHING = "CONTACT_WITH_NOTHING"
    CONTACT_AMBIGUOUS = "CONTACT_AMBIGUOUS"
    CONTACT_IN_HARD_ZONE = "CONTACT_IN_HARD_ZONE"
    NOT_SURVEYED = "NOT_SURVEYED"


class SurveyError(ValueError):
    """A cell file that contradicts itself. `code` is the reason, `detail` names the place."""

    def __init__(self, code: SurveyFault, detail: str) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail


def numbers_only(table: Mapping[str, Any]) -> CellParameters:
    """Numbers of the engine from a configuration, over a cell without objects.

    Raises:
        CellError: as `CellParameters.from_table`; also for what only a signed cell file may state.
    """
    for name in SURVEYED:
        if name in table:
            raise CellError("PARAMETERS_WRONG", f"{name} belongs to the signed cell file")
    return replace(CellParameters.from_table(table), objects=())


def surveyed(cell: Cell, numbers: CellParameters) -> CellParameters:
    """Parameters of a cell: the signed file's content, and the engine's numbers.

    Args:
        cell: a verified cell file.
        numbers: everything else, as `numbers_only` reads it.

    Raises:
        SurveyError: the file contradicts itself.
    """
    for error in contradictions(cell):
        raise error
    area = cell.workspace
    parameters = replace(
        numbers,
        tool=cell.tool,
        payload_kg=None if cell.payload_g is None else si(cell.payload_g, Unit.GRAM),
        objects=tuple(StaticObject(o.name, _kind(o.kind), **_shape(o.shape)) for o in cell.objects),
        zones=tuple(
            StaticZone(z.name, None if z.tier is None else int(z.tier), **_shape(z.shape))  # type: ignore[arg-type]  # 1 to 4, as read
            for z in cell.zones
        ),
        workspace=None if area is None else Workspace(_metres(area.low_um), _metres(area.high_um)),
        contacts=tuple(Contact(c.object, "tool" if c.by == "tool" else "payload") for c in cell.contacts),
        outputs=tuple(Output(o.number, int(o.tier), o.name) for o in cell.outputs),  # type: ignore[arg-type]  # 0 to 4
    )
    wrong = parameters.defect()
    if wrong is not None:
        raise SurveyError(SurveyFault.NOT_SURVEYED, wrong)
    return parameters


def contradictions(cell: Cell) -> Iterator[SurveyError]:
    """Everything in which a cell file contradicts itself."""
    objects = {thing.name: thing.shape for thing in cell.objects}
    hard = {zone.name: zone.shape for zone in cell.zones if zone.tier is None}
    for name, shape in (*objects.items(), *((zone.name, zone.shape) for zone in cell.zones)):
        if _furthest_um(shape) > CELL_REACH_UM:
            yield SurveyError(SurveyFault.OUT_OF_REACH, name)
        if isinstance(shape, wire.Convex):
            yield from _flat(name, shape)
    area = cell.workspace
    if area is not None:
        if max(map(abs, (*area.low_um, *area.high_um))) > CELL_REACH_UM:
            yield SurveyError(SurveyFault.OUT_OF_REACH, "workspace")
        # The base is the origin. An arm whose base is outside would be in violation for ever.
        if not all(low <= 0 <= high for low, high in zip(area.low_um, area.high_um, strict=True)):
            yield SurveyError(SurveyFault.BASE_OUTSIDE_WORKSPACE, "workspace")
    taken = {*objects, *(zone.name for zone in cell.zones)}
    for contact in cell.contacts:
        if contact.observed:
            if contact.object in taken:
                yield SurveyError(SurveyFault.CONTACT_AMBIGUOUS, contact.object)
            continue
        if contact.object not in objects:
            yield SurveyError(SurveyFault.CONTACT_WITH_NOTHING, contact.object)
            continue
        around = next((z for z, shape in hard.items() if _inside(objects[contact.object], shape)), None)
        if around is not None:
            yield SurveyError(SurveyFault.CONTACT_IN_HARD_ZONE, f"{contact.object} in {around}")


def _flat(name: str, shape: wire.Convex) -> Iterator[SurveyError]:
    try:
        hull_of(tuple(map(_metres, shape.vertices_um)))
    except SceneError as error:
        yield SurveyError(SurveyFault.NOT_SURVEYED, f"{name}: {error.detail}")


def _furthest_um(shape: Shape) -> int:
    """The largest coordinate or size in it."""
    match shape:
        case wire.Capsule(a, b, radius):
            return max(map(abs, (*a, *b, radius)))
        case wire.Sphere(center, radius):
            return max(map(abs, (*center, radius)))
        case wire.Box(center, half, _):
            return max(map(abs, (*center, *half)))
        case wire.Convex(vertices, radius):
            return max(radius, *(abs(number) for vertex in vertices for number in vertex))
        case _:
            assert_never(shape)


def _inside(thing: Shape, zone: Shape) -> bool:
    """True where all of a thing is inside a zone: then no part of it can be touched without entering.

    Both are convex: the thing is the hull of some balls, and inside exactly when each of them is.
    """
    return all(_depth_um(point, zone) >= radius for point, radius in _balls(thing))


def _balls(shape: Shape) -> list[tuple[tuple[float, ...], float]]:
    """Balls of which the shape is the convex hull: (centre, radius) in micrometres."""
    match shape:
        case wire.Capsule(a, b, radius):
            return [(a, radius), (b, radius)]
        case wire.Sphere(center, radius):
            return [(center, radius)]
        case wire.Box(center, half, quaternion):
            axes = _axes(quaternion)
            signs = [(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
            return [
                (tuple(center[d] + sum(s[n] * half[n] * axes[n][d] for n in range(3)) for d in range(3)), 0.0)
                for s in signs
            ]
        case wire.Convex(vertices, radius):
            return [(vertex, radius) for vertex in vertices]
        case _:
            assert_never(shape)


def _depth_um(point: tuple[float, ...], zone: Shape) -> float:
    """Depth of the point below the zone's surface, in micrometres; negative outside."""
    match zone:
        case wire.Sphere(center, radius):
            return radius - math.dist(point, center)
        case wire.Capsule(a, b, radius):
            along = [q - p for p, q in zip(a, b, strict=True)]
            length2 = sum(x * x for x in along)
            share = sum(x * (p - q) for x, p, q in zip(along, point, a, strict=True)) / length2 if length2 else 0.0
            share = min(1.0, max(0.0, share))
            return radius - math.dist(point, [p + share * x for p, x in zip(a, along, strict=True)])
        case wire.Box(center, half, quaternion):
            away = [p - c for p, c in zip(point, center, strict=True)]
            axes = _axes(quaternion)
            return min(
                h - abs(sum(x * y for x, y in zip(axis, away, strict=True))) for h, axis in zip(half, axes, strict=True)
            )
        case wire.Convex(vertices, radius):
            return radius + _depth_in_hull_um(point, vertices)
        case _:
            assert_never(zone)


def _depth_in_hull_um(point: tuple[float, ...], vertices: tuple[Point, ...]) -> float:
    """Depth of the point behind the nearest face; outside, minus its distance."""
    hull, at = hull_of(tuple(map(_metres, vertices))), np.array([point]) / Unit.MICROMETRE.per_si
    behind = float((hull.offsets - at[0] @ hull.normals.T).min())
    if behind < 0:
        on_point, on_hull = segment_hull(at, at, hull)
        behind = -float(np.linalg.norm(on_point - on_hull))
    return behind * Unit.MICROMETRE.per_si


def _axes(quaternion_ppm: tuple[int, int, int, int]) -> tuple[tuple[float, ...], ...]:
    """The box's own axes, by its unit quaternion."""
    norm = math.sqrt(sum(c * c for c in quaternion_ppm))
    w, x, y, z = (c / norm for c in quaternion_ppm)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def _kind(kind: str) -> Any:
    return kind  # one of observation.OBJECT_KINDS, as read


def _shape(shape: Shape) -> dict[str, Any]:
    return {type(shape).__name__.lower(): shape_of(shape)}


def _metres(point_um: Point) -> tuple[float, float, float]:
    x, y, z = (si(number, Unit.MICROMETRE) for number in point_um)
    return (x, y, z)

"""Picture of a cell without a motion: what stands and is seen there, and the arm at rest."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, assert_never

from pep.pit.base.motion import GripperMove
from pep.pit.picture.picture import DrawnBody, Picture, bodies_in, parts_of
from pep.pit.picture.postures import route_of
from pep.pit.scene.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.pit.files.scene_file import Situation
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Shape

AT_REST: Final = (0.0, -1.62, 1.25, -1.20, -1.57, 0.0)
"""Joint angles, rad: the tool over the table, pointing down, as at the middle of the examples' sweep."""


def cell_picture(robot: Robot, situation: Situation, value: Mapping[str, Any]) -> Picture:
    """The picture of a cell.

    Args:
        robot: the arm that is drawn, with what it holds.
        situation: what stands and is seen.
        value: of the world file, for the cell's name.
    """
    cell = situation.cell
    scene = cell.surveyed if situation.scene is None else situation.scene
    rest = route_of(robot, GripperMove(AT_REST, 0.0, 0.1, 20.0), cell, perception_age_s=0.0)
    named = value.get("cell", {}).get("name")
    area = scene.workspace
    return Picture(
        title=f"{'Cell' if named is None else named}: {robot.model.name} with {robot.tool.name}",
        postures=rest.postures([0.0]),
        parts=parts_of(robot),
        bodies=tuple(replace(body, note=_note(body, cell)) for body in bodies_in(scene, seen_s=situation.age_s or 0.0)),
        workspace=None if area is None else (area.low_m, area.high_m),
        witnesses=(),
        assessment=None,
    )


def said_of(value: Mapping[str, Any]) -> str:
    """Members of a cell that are no bodies, in one line."""
    cell = value.get("cell", {})
    held = cell.get("payload_kg", 0.0)
    outputs = [f"{each['name']} (pin {each['pin']}, tier {each['tier']})" for each in cell.get("outputs", ())]
    said = [
        f"for {cell['audience']}" if cell.get("audience") else "",
        f"held by default: {held if isinstance(held, str) else f'{held or 0.0:g} kg'}" if cell else "",
        f"sensors: {', '.join(cell['sensors'])}" if cell.get("sensors") else "",
        f"outputs: {', '.join(outputs)}" if outputs else "",
    ]
    return "; ".join(part for part in said if part)


def told_of(shape: Shape) -> str:
    """Form, size and place of a shape in words, in metres."""
    match shape:
        case Box(center, half, quaternion):
            size = " × ".join(f"{2 * each:.2f}" for each in half)
            turned = "" if math.isclose(abs(quaternion[0]), 1.0) else ", turned"
            return f"box {size}{turned}, middle {_place(center)}"
        case Sphere(center, radius):
            return f"sphere, radius {radius:.3g}, middle {_place(center)}"
        case Capsule(a, b, radius):
            return f"capsule, radius {radius:.3g}, from {_place(a)} to {_place(b)}"
        case Convex(vertices, radius):
            middle = tuple(sum(each) / len(vertices) for each in zip(*vertices, strict=True))
            rounding = f", rounded by {radius:.3g}" if radius else ""
            return f"convex, {len(vertices)} corners{rounding}, about {_place(middle)}"
        case _:
            assert_never(shape)


def _place(point: tuple[float, ...]) -> str:
    return f"({', '.join(f'{each:.2f}' for each in point)})"


def _note(body: DrawnBody, cell: CellParameters) -> str:
    if body.kind == "zone":
        return "nothing may enter" if body.tier is None else f"entering is tier {body.tier}"
    touching = [each.by for each in cell.contacts if each.object == body.name]
    return f"may be touched by {' and '.join(touching)}" if touching else ""

"""Content of a picture of a cell or an assessment, as plain values in metres, for every way of drawing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np

from pep.pit.picture.postures import nearest, route_of
from pep.pit.picture.surface import surface_of
from pep.pit.picture.words import MICRO_PER_MILLI, MILLI, headline
from pep.pit.scene.scene import CELL_FILE, Box, Capsule, Convex, Scene, Sphere
from pep.pit.scene.view import view_of

if TYPE_CHECKING:
    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.motion import Motion
    from pep.pit.files.scene_file import Situation
    from pep.pit.picture.postures import Nearest, Posture, PostureCapsule
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.scene import Shape, Vector
    from policies.evidence.evidence import Contribution

STEPS: Final = 48  # ours, as below
"""Instants that are drawn, start and end included; those of the witnesses are added."""
LED: Final = "An arm that is led"
PAYLOAD: Final = "payload"
DECIMALS: Final = 5  # of a metre: a hundredth of a millimetre


@dataclass(frozen=True, slots=True)
class DrawnBody:
    """DrawnBody at rest: its kind, name, shape and source.

    Attributes:
        tier: that of a zone that has one.
        source: the sensor, or "" for the signed cell file.
        age_s: age of the sighting, all in all; 0 for a surveyed object.
        note: what else is to be said of it, as that the tool may touch it.
        armless: part of a person of whose arms no region is seen: they are not drawn, and may be anywhere near.
    """

    kind: str
    name: str
    shape: Shape
    tier: int | None = None
    source: str = CELL_FILE
    age_s: float = 0.0
    note: str = ""
    armless: bool = False

    @property
    def told(self) -> str:
        """Source in a few words; "" for a surveyed body."""
        return f"{self.source}, {self.age_s:.2f} s" if self.source else ""


@dataclass(frozen=True, slots=True)
class DrawnPlace:
    """Place of one contribution: the part and the thing at their nearest."""

    contribution: Contribution
    posture: int
    near: Nearest


@dataclass(frozen=True, slots=True)
class Picture:
    """Everything that is drawn.

    Attributes:
        title: tier and index, and what decides, in words.
        postures: the arm over time; none where the motion does not concern it. The witnesses' instants are among them.
        parts: kind of each of a posture's parts: "base", "arm", "tool" or "payload".
        bodies: people's regions, objects and zones.
        workspace: low and high corner, or None.
        witnesses: of the contributions that happen somewhere, in their order.
        assessment: all of it; None for a picture of a cell, where nothing moves, or of an arm that is led.
        margin_m: the arm's capsules at the postures, widened by it, hold the arm at every time; None where unknown.
    """

    title: str
    postures: tuple[Posture, ...]
    parts: tuple[str, ...]
    bodies: tuple[DrawnBody, ...]
    workspace: tuple[Vector, Vector] | None
    witnesses: tuple[DrawnPlace, ...]
    assessment: Assessment | None
    margin_m: float | None = None


def picture(
    robot: Robot, situation: Situation, motion: Motion, assessment: Assessment | None, *, steps: int = STEPS
) -> Picture:
    """The picture of an answer.

    Args:
        robot: with what it holds.
        situation: that was asked about.
        motion: that was asked about.
        assessment: the answer; None for an arm that is led, of whose way only the start is known.
        steps: instants that are drawn, start and end included, 2 or more; those of the witnesses are added.
    """
    cell = situation.cell
    scene = cell.surveyed if situation.scene is None else situation.scene
    age_s = view_of(situation.scene, situation.age_s, cell).stopping_age_s
    route = route_of(robot, motion, cell, perception_age_s=age_s)
    whole = route.duration_s
    regular = [whole * k / (steps - 1) for k in range(steps)] if whole > 0 else [0.0]
    causes = () if assessment is None else assessment.contributions
    times = sorted({*regular, *(min(c.at_ms / MILLI, whole) for c in causes)})
    shown = route.postures(times)
    bodies = bodies_in(scene, seen_s=situation.age_s or 0.0)
    found = (_witness(c, shown, bodies, scene, whole) for c in causes)
    area = scene.workspace
    return Picture(
        title=LED if assessment is None else headline(assessment),
        postures=shown,
        parts=parts_of(robot) if shown else (),
        bodies=bodies,
        workspace=None if area is None else (area.low_m, area.high_m),
        witnesses=tuple(w for w in found if w is not None),
        assessment=assessment,
        margin_m=None if assessment is None else route.margin_m(times),
    )


def bodies_in(scene: Scene, *, seen_s: float) -> tuple[DrawnBody, ...]:
    """Everybody and everything in a scene that was seen so long ago."""
    return (
        *(
            DrawnBody(
                "person", f"{p.id}/{region}", shape, None, p.source, seen_s + p.age_s, armless=not p.limbs_tracked
            )
            for p in scene.people
            for region, shape in p.regions
        ),
        *(
            DrawnBody(o.kind, o.id, o.shape, None, o.source, seen_s + o.age_s if o.source else 0.0)
            for o in scene.objects
        ),
        *(DrawnBody("zone", z.id, z.shape, z.tier) for z in scene.zones),
    )


def parts_of(robot: Robot) -> tuple[str, ...]:
    """Kind of each capsule of a robot: "base", "arm", "tool" or "payload"."""
    return tuple(_part(c.name, c.link, robot) for c in robot.capsules)


def _part(name: str, link: int, robot: Robot) -> str:
    if name == PAYLOAD:
        return "payload"
    if any(name == capsule.name for capsule in robot.tool.capsules):
        return "tool"
    return "base" if link == 0 else "arm"


def _witness(
    told: Contribution, shown: tuple[Posture, ...], bodies: tuple[DrawnBody, ...], scene: Scene, whole_s: float
) -> DrawnPlace | None:
    """Place of a contribution, or None for one without place (a limit, the age of the view)."""
    t = min(told.at_ms / MILLI, whole_s)
    row = next((k for k, posture in enumerate(shown) if posture.t_s == t), None)
    if row is None:
        return None
    parts = {part.name: part for part in shown[row].parts}
    part = parts.get(told.link)
    if part is None:
        return None
    others: list[Shape] = [body.shape for body in bodies if body.name == told.object]
    if told.kind == "self" and told.object in parts:
        other = parts[told.object]
        others = [Capsule(other.a_m, other.b_m, other.radius_m)]
    if told.kind == "workspace" and scene.workspace is not None:
        return DrawnPlace(told, row, _to_face(part, scene.workspace.low_m, scene.workspace.high_m))
    near = [nearest(part, shape) for shape in others]
    return DrawnPlace(told, row, min(near, key=lambda n: n.clearance_m)) if near else None


def _to_face(part: PostureCapsule, low: Vector, high: Vector) -> Nearest:
    """The part's point that is nearest to a face of the workspace, or farthest beyond one."""
    from pep.pit.picture.postures import Nearest

    ways: list[tuple[float, Nearest]] = []
    for end in (part.a_m, part.b_m):
        for axis in range(3):
            for face, sign in ((low[axis], -1.0), (high[axis], 1.0)):
                gap = sign * (face - end[axis]) - part.radius_m
                here = [*end]
                here[axis] += sign * part.radius_m
                there = [*end]
                there[axis] = face
                near = Nearest((here[0], here[1], here[2]), (there[0], there[1], there[2]), gap)
                ways.append((gap, near))
    return min(ways, key=lambda way: way[0])[1]


def plain(shape: Shape) -> dict[str, Any]:
    """Shape as JSON: axis and radius of a round one; triangles, rods and corners of a flat one."""
    match shape:
        case Capsule(a, b, radius):
            return {"a": _rounded(a), "b": _rounded(b), "r": round(radius, DECIMALS)}
        case Sphere(center, radius):
            return {"a": _rounded(center), "b": _rounded(center), "r": round(radius, DECIMALS)}
        case Box() | Convex():
            surface = surface_of(shape)
            return {
                "triangles": np.round(surface.triangles, DECIMALS).tolist(),
                "rods": np.round(surface.rods, DECIMALS).tolist(),
                "corners": np.round(surface.corners, DECIMALS).tolist(),
                "r": round(surface.radius_m, DECIMALS),
            }
        case _:
            assert_never(shape)


def to_plain(shown: Picture) -> dict[str, Any]:
    """The picture as JSON, to a hundredth of a millimetre."""
    return {
        "title": shown.title,
        "whole": shown.assessment is None,
        "parts": [
            {"kind": kind, "name": part.name, "r": part.radius_m}
            for kind, part in zip(shown.parts, shown.postures[0].parts if shown.postures else (), strict=True)
        ],
        "postures": [posture_to_plain(posture) for posture in shown.postures],
        "bodies": [body_to_plain(body) for body in shown.bodies],
        "workspace": None if shown.workspace is None else [_rounded(corner) for corner in shown.workspace],
        "witnesses": [
            {
                "row": row_of(shown, w),
                "posture": w.posture,
                "a": _rounded(w.near.on_part_m),
                "b": _rounded(w.near.on_thing_m),
                "clearance_mm": round(w.contribution.clearance_um / MICRO_PER_MILLI, 1),
                "kind": w.contribution.kind,
                "link": w.contribution.link,
                "object": w.contribution.object,
            }
            for w in shown.witnesses
        ],
    }


def posture_to_plain(posture: Posture) -> dict[str, Any]:
    """Posture as JSON: its time, s, the ends of each part, and the tool point, m."""
    return {
        "t": round(posture.t_s, 4),
        "ends": [[_rounded(part.a_m), _rounded(part.b_m)] for part in posture.parts],
        "tcp": _rounded(posture.tcp_m),
    }


def body_to_plain(body: DrawnBody) -> dict[str, Any]:
    """Body as JSON: its kind, name, tier and source, whether a person's arms are not seen, and its shape."""
    about = {"kind": body.kind, "name": body.name, "tier": body.tier, "told": body.told}
    return {**about, **({"armless": True} if body.armless else {}), **plain(body.shape)}


def row_of(shown: Picture, witness: DrawnPlace) -> int:
    """Place of a witness's contribution among all of the answer."""
    return -1 if shown.assessment is None else shown.assessment.contributions.index(witness.contribution)


def _rounded(point: Vector) -> list[float]:
    return [round(x, DECIMALS) for x in point]

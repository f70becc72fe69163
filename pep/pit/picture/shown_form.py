"""Picture of an assessment as an ask carries it: whole numbers, few enough to be read at once ([STM-25])."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Final, assert_never

from msgspec import structs

from capabilities.statements.people import picture as wire
from capabilities.values.errors import StatementError
from pep.pit.geometry.hull import hull_of
from pep.pit.picture.picture import STEPS, picture
from pep.pit.picture.surface import corners_of
from pep.pit.scene.scene import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.motion import Motion
    from pep.pit.files.scene_file import Situation
    from pep.pit.picture.picture import DrawnBody, DrawnPlace, Picture
    from pep.pit.picture.postures import Posture
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.scene import Vector

MICRO: Final = 1e6  # micrometres of a metre
MILLI: Final = 1e3  # milliseconds of a second
FEWER: Final = (STEPS // 2, STEPS // 4)
"""Instants that are tried one after the other where the text is too long with all of them."""
ROUNDING_UM: Final = 1
"""More than a point and its whole numbers are apart: half a micrometre along each axis is 0.87."""
BOX_FACES: Final = (
    *(0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5),  # lowest and highest x
    *(0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6),  # y
    *(0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3),  # z
)
"""Triangles of an upright box whose corners go by x, then y, then z.

Seen from outside they go round to the left.
"""
BOX_NUMBERS: Final = 8 * 3  # corners of a box, and three numbers for each
KEPT_OF: Final = (3, 4)
"""Share of the bodies that is tried next where all of them are too many."""


def shown_text(robot: Robot, situation: Situation, motion: Motion, assessment: Assessment | None) -> str | None:
    """Text of the picture that people are shown of a motion; None for an act without the arm.

    With very many bodies it has fewer postures, then boxes in place of hulls, then only the bodies that matter most.

    Args:
        robot: with what it holds.
        situation: that was asked about.
        motion: that was asked about.
        assessment: the answer; None for an arm that is led, of whose way only the start is known.

    Raises:
        StatementError: it has no such form.
        PitError: a motion that could not be assessed either.
    """
    drawn = picture(robot, situation, motion, assessment, steps=STEPS)
    if not drawn.postures:
        return None
    whole = _whole(drawn)
    for steps in FEWER:
        if (text := _short(whole)) is not None:
            return text
        whole = _whole(picture(robot, situation, motion, assessment, steps=steps))
    return _short(whole) or _crowded(whole)


def _crowded(whole: wire.ShownPicture) -> str:
    """Text with boxes, and with as many bodies as there is room for, people and what decides first."""
    named = {place.object for place in whole.places}
    bodies = sorted(map(_boxed, whole.bodies), key=lambda body: (body.name not in named, body.kind != "person"))
    kept = len(bodies)
    while (text := _short(structs.replace(whole, bodies=tuple(bodies[:kept]), omitted=len(bodies) - kept))) is None:
        if kept == 0:
            return wire.write(whole)  # raises: the arm alone is too much
        kept = kept * KEPT_OF[0] // KEPT_OF[1]
    return text


def _short(shown: wire.ShownPicture) -> str | None:
    """The text, or None where it is too long."""
    try:
        return wire.write(shown)
    except StatementError:
        return None


def _whole(drawn: Picture) -> wire.ShownPicture:
    first = drawn.postures[0]
    return wire.ShownPicture(
        form=wire.FORM,
        margin_um=wire.UNKNOWN_UM if drawn.margin_m is None else math.ceil(drawn.margin_m * MICRO) + ROUNDING_UM,
        parts=tuple(
            wire.ShownPart(kind, part.name, math.ceil(part.radius_m * MICRO))
            for kind, part in zip(drawn.parts, first.parts, strict=True)
        ),
        postures=tuple(_posture(each) for each in drawn.postures),
        bodies=tuple(_body(each) for each in drawn.bodies),
        workspace_um=() if drawn.workspace is None else _um(drawn.workspace),
        places=tuple(_place(each) for each in drawn.witnesses[: wire.PLACES]),
    )


def _posture(drawn: Posture) -> wire.ShownPosture:
    ends = _um(end for part in drawn.parts for end in (part.a_m, part.b_m))
    return wire.ShownPosture(round(drawn.t_s * MILLI), ends, _um([drawn.tcp_m]))


def _body(drawn: DrawnBody) -> wire.ShownBody:
    faces: tuple[int, ...] = ()
    match drawn.shape:
        case Capsule(a, b, radius_m):
            corners: Iterable[Vector] = (a, b)
        case Sphere(center, radius_m):
            corners = (center,)
        case Box() | Convex():
            hull = hull_of(corners_of(drawn.shape))
            corners = [(x, y, z) for x, y, z in hull.vertices.tolist()]
            faces = tuple(hull.faces.ravel().tolist())
            radius_m = drawn.shape.radius_m if isinstance(drawn.shape, Convex) else 0.0
        case _:
            assert_never(drawn.shape)
    return wire.ShownBody(
        kind=drawn.kind,
        name=drawn.name,
        corners_um=_um(corners),
        faces=faces,
        radius_um=math.ceil(radius_m * MICRO),
        tier=drawn.tier,
        source=drawn.source,
        age_ms=math.ceil(drawn.age_s * MILLI) if drawn.source else 0,
    )


def _boxed(body: wire.ShownBody) -> wire.ShownBody:
    """The body, or for a hull of many corners the upright box around it."""
    if len(body.corners_um) <= BOX_NUMBERS:
        return body
    sides = [(min(body.corners_um[k::3]), max(body.corners_um[k::3])) for k in range(3)]
    corners = tuple(number for corner in product(*sides) for number in corner)
    return structs.replace(body, corners_um=corners, faces=BOX_FACES)


def _place(drawn: DrawnPlace) -> wire.ShownPlace:
    told = drawn.contribution
    return wire.ShownPlace(
        told.kind,
        told.link,
        told.object,
        drawn.posture,
        _um([drawn.near.on_part_m]),
        _um([drawn.near.on_thing_m]),
        told.clearance_um,
        told.speed_um_s,
        told.index_milli,
    )


def _um(points: Iterable[Vector]) -> tuple[int, ...]:
    return tuple(round(number * MICRO) for point in points for number in point)

"""Detections in a camera's frame, as people and things in the base frame.

A detection is a box of pixels with the depths between which it lies, or a solid box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from pep.sensor.camera import checked_pixels
from pep.sensor.metres import PersonSight, hull, length, number, place, rod, thing
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from capabilities.statements.observation import ObservedObject
    from pep.sensor.camera import Camera
    from pep.sensor.metres import Place

    Kind = Literal["person", "fragile", "rigid"]

LEAST_CONFIDENCE: Final = 0.5
"""A detection below is of no known kind. Ours."""
PERSON_FROM_M: Final = 0.5
"""Something of no known kind counts as a person from this extent on: the worst that it could be. Ours."""
WHOLE: Final = ("body parts",)
"""Unseen of a person of whom only an extent or a place is known."""


@dataclass(frozen=True, slots=True)
class PixelBox:
    """A detection in an image: its box of pixels, and the depths between which it lies.

    Attributes:
        label: class name of the detector.
        pixels: u0, v0, u1, v1.
        near_m, far_m: least and largest depth of it; a depth image shows the first, and the second is yours to state.
        confidence: of the label.
        id: the same in every frame; needed of a thing.
    """

    label: str
    pixels: Sequence[float]
    near_m: float
    far_m: float
    confidence: float = 1.0
    id: str = ""

    def corners_m(self, camera: Camera) -> list[Place]:
        """Its eight corners in the camera's own frame."""
        u0, v0, u1, v1 = checked_pixels(self.pixels)
        if number(self.near_m, "near_m") == 0:
            raise SensorError(
                SensorFault.NO_DEPTH, f"no depth of {self.label[:64]!r}", "Take the least depth inside it."
            )
        near, far = length(self.near_m, "near_m"), length(self.far_m, "far_m")
        if not near < far:
            raise SensorError(SensorFault.SIGHT_MALFORMED, "far_m is not beyond near_m", "Add how deep it may be.")
        return [camera.point(u, v, depth) for u, v, depth in product((u0, u1), (v0, v1), (near, far))]


@dataclass(frozen=True, slots=True)
class SolidBox:
    """A detection with its place and sizes along the axes of the camera's own frame.

    OAK-D, ZED and ROS (vision_msgs) give such ones.

    Attributes:
        label, confidence, id: as of `PixelBox`.
        center_m: its middle.
        size_m: its whole sizes.
    """

    label: str
    center_m: Sequence[float]
    size_m: Sequence[float]
    confidence: float = 1.0
    id: str = ""

    def corners_m(self, _camera: Camera) -> list[Place]:
        """Its eight corners in the camera's own frame."""
        middle = place(self.center_m, "center_m")
        if not any(middle):
            raise SensorError(
                SensorFault.NO_DEPTH, f"{self.label[:64]!r} is at (0, 0, 0)", "Leave it out of the frame."
            )
        half = [length(each, "size_m") / 2 for each in place(self.size_m, "size_m")]
        return [
            (middle[0] + i * half[0], middle[1] + j * half[1], middle[2] + k * half[2])
            for i, j, k in product((-1, 1), repeat=3)
        ]


Detection: TypeAlias = PixelBox | SolidBox


def detected(
    found: Iterable[Detection], camera: Camera, *, kinds: Mapping[str, Kind], error_m: float = 0.0
) -> tuple[list[PersonSight], list[ObservedObject]]:
    """People and things of one frame, in the base frame.

    One without a stated kind, or with a confidence below 0.5, is the worst that it could be: a person from 0.5 m on,
    else fragile.

    Args:
        found: all of the frame.
        camera: in whose frame they are.
        kinds: of each label.
        error_m: by which they may be larger or elsewhere.

    Raises:
        SensorError: with the place and the next step.
    """
    people: list[PersonSight] = []
    things: list[ObservedObject] = []
    for one in found:
        corners = [camera.in_base(corner) for corner in one.corners_m(camera)]
        if _kind(one, corners, kinds) == "person":
            people.append(_person(corners, number(error_m, "error_m"), one.id))
        elif not one.id:
            raise SensorError(
                SensorFault.SIGHT_MALFORMED, f"{one.label[:64]!r} is a thing without an id", "Give your tracker's."
            )
        else:
            kind: Literal["fragile", "rigid"] = "rigid" if _kind(one, corners, kinds) == "rigid" else "fragile"
            things.append(thing(one.id, kind, hull(corners, error_m)))
    return people, things


def person_at(x_m: float, y_m: float, *, floor_z_m: float, name: str = "", radius_m: float = 0.30) -> PersonSight:
    """Person of whom only the place on the floor is known.

    A tag, a people counter or a leg detector knows no more.

    Args:
        x_m: of the body's axis, in the base frame.
        y_m: the same.
        floor_z_m: height of the floor there.
        name: the person's id; "" for one who is known again by place.
        radius_m: of the upright body: half a breadth at the shoulders of 0.55 m, and the place's error.
    """
    at = place((x_m, y_m, floor_z_m), "the place")
    return PersonSight((("head", rod(at, (at[0], at[1], at[2] + TALL_M), radius_m)),), name, unseen=WHOLE)


TALL_M: Final = 2.0
"""Height of a person that is not known; above the 95th percentile of men, 1.87 m (Huston 2009)."""


def _kind(one: Detection, corners: Sequence[Place], kinds: Mapping[str, Kind]) -> str:
    confidence = number(one.confidence, "confidence")
    if not 0 <= confidence <= 1:
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"a confidence of {confidence:g}", "Give 0 to 1.")
    stated = kinds.get(one.label)
    if stated == "person" or (stated is not None and confidence >= LEAST_CONFIDENCE):
        return stated
    extent_m = max(max(axis) - min(axis) for axis in zip(*corners, strict=True))
    return "person" if extent_m >= PERSON_FROM_M else "fragile"


def _person(corners: Sequence[Place], error_m: float, name: str) -> PersonSight:
    """Person anywhere among the eight corners: a rod around all, of the region with the least limits."""
    ends = max(
        ((_middle(corners, axis, 0), _middle(corners, axis, 1)) for axis in (4, 2, 1)),
        key=lambda pair: math.dist(*pair),
    )
    radius_m = max(_apart_m(corner, *ends) for corner in corners)
    return PersonSight((("head", rod(*ends, radius_m + error_m)),), name, unseen=WHOLE)


def _middle(corners: Sequence[Place], axis: int, side: int) -> Place:
    """Middle of one of the six faces: corners are in the order of `product` over three axes of two sides."""
    face = [corner for number_, corner in enumerate(corners) if bool(number_ & axis) == bool(side)]
    x, y, z = (sum(each) / len(face) for each in zip(*face, strict=True))
    return x, y, z


def _apart_m(point: Place, a: Place, b: Place) -> float:
    """Distance of a point from a straight line's piece."""
    along = [q - p for p, q in zip(a, b, strict=True)]
    share = sum(d * (p - q) for d, p, q in zip(along, point, a, strict=True)) / sum(d * d for d in along)
    share = min(1.0, max(0.0, share))
    return math.dist(point, [p + share * d for p, d in zip(a, along, strict=True)])

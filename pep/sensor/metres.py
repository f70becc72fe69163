"""Shapes, people and things in metres of the robot's base frame, as statements have them in whole micrometres."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Final, Literal

from capabilities.statements import observation as wire
from capabilities.values.errors import CapabilityError
from capabilities.values.units import Unit
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Sequence

Place = tuple[float, float, float]
"""x, y, z in metres."""

FAR_M: Final = 30.0
"""Farthest place in a cell, from its robot or camera: a larger number is in another unit. Ours."""
IN_METRES: Final = "Give metres: millimetres divided by 1000."
UPRIGHT: Final = (wire.PPM, 0, 0, 0)


def number(value: object, where: str) -> float:
    """The finite number that this is.

    Raises:
        SensorError: `NOT_FINITE` or `SIGHT_MALFORMED`.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"{where} is no number", "Give a number.")
    found = float(value)
    if not math.isfinite(found):
        raise SensorError(
            SensorFault.NOT_FINITE, f"{where} is {found}", "Leave out what was not measured: say None, or nothing."
        )
    return found


def length(value: object, where: str) -> float:
    """The length in metres, above 0.

    Raises:
        SensorError: as `number`; `NOT_METRES` from 30 m on.
    """
    found = number(value, where)
    if not found > 0:
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"{where} is {found:g} m", "Give a length above 0.")
    if not found <= FAR_M:
        raise SensorError(SensorFault.NOT_METRES, f"{where} is {found:g} m", IN_METRES)
    return found


def place(value: object, where: str) -> Place:
    """The place that these three numbers are, in metres.

    Raises:
        SensorError: as `number`; `NOT_METRES` beyond 30 m.
    """
    if not isinstance(value, Iterable) or isinstance(value, str | bytes):
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"{where} is no place", "Give three numbers.")
    found = tuple(number(each, where) for each in value)
    if len(found) != 3:
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"{where} has {len(found)} numbers", "Give three: x, y, z.")
    if not max(map(abs, found)) <= FAR_M:
        far_m = max(map(abs, found))
        raise SensorError(SensorFault.NOT_METRES, f"{where} is {far_m:g} m away", IN_METRES)
    x, y, z = found
    return x, y, z


def ball(center_m: Sequence[float], radius_m: float) -> wire.Sphere:
    """All within a radius of a place."""
    return wire.Sphere(_um(place(center_m, "center_m")), _size_um(length(radius_m, "radius_m")))


def rod(a_m: Sequence[float], b_m: Sequence[float], radius_m: float) -> wire.Capsule:
    """All within a radius of the straight line from one place to another."""
    return wire.Capsule(_um(place(a_m, "a_m")), _um(place(b_m, "b_m")), _size_um(length(radius_m, "radius_m")))


def box(center_m: Sequence[float], half_m: Sequence[float]) -> wire.Box:
    """A box along the axes of the base frame, by its middle and half its sizes."""
    x, y, z = (_size_um(length(each, "half_m")) for each in place(half_m, "half_m"))
    return wire.Box(_um(place(center_m, "center_m")), (x, y, z), UPRIGHT)


def hull(corners_m: Iterable[Sequence[float]], radius_m: float = 0.0) -> wire.Convex:
    """All within a radius of the convex hull of 4 to 64 corners."""
    corners = tuple(_um(place(each, "a corner")) for each in corners_m)
    radius_um = 0 if radius_m == 0 else _size_um(length(radius_m, "radius_m"))
    try:
        shape = wire.Convex(corners, radius_um)
        wire.check(shape)
    except CapabilityError as error:
        raise SensorError(
            SensorFault.SIGHT_MALFORMED, f"the corners are of no body: {error.detail}", "Give 4 to 64 that span one."
        ) from error
    return shape


@dataclass(frozen=True, slots=True)
class PersonSight:
    """One person as a sensor saw them.

    Attributes:
        regions: pairs of a body region (`capabilities.statements.observation.REGIONS`) and its shape.
        id: "" for one whom the sensor does not know again: `Sensor.see` does, by place.
        age_s: time since the person was seen there; 0 is now.
        unseen: parts of the body that were assumed and not seen.
    """

    regions: tuple[tuple[str, wire.Capsule | wire.Sphere], ...]
    id: str = ""
    age_s: float = 0.0
    unseen: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < len(self.regions) <= wire.REGIONS_OF_A_PERSON:
            raise SensorError(SensorFault.SIGHT_MALFORMED, "a person without regions, or with over 64", "Give 1 to 64.")
        for region, shape in self.regions:
            if region not in wire.REGIONS or not isinstance(shape, wire.Capsule | wire.Sphere):
                raise SensorError(
                    SensorFault.SIGHT_MALFORMED,
                    f"{str(region)[:32]!r} is no body region with a rod or a ball",
                    f"Take one of {', '.join(sorted(wire.REGIONS))}.",
                )
        if not 0 <= number(self.age_s, "age_s") * 1000 <= wire.SIGHTING_AGE_MS:
            raise SensorError(SensorFault.SIGHT_MALFORMED, f"age_s is {self.age_s:g}", "Give 0 to 3600.")

    @property
    def middle_m(self) -> tuple[float, float]:
        """Place on the floor: the mean of all regions' middles, x and y in metres."""
        places = [_middle_um(shape) for _, shape in self.regions]
        x, y = (sum(each[axis] for each in places) / len(places) / Unit.MICROMETRE.per_si for axis in (0, 1))
        return x, y


def thing(name: str, kind: Literal["fragile", "rigid"], shape: wire.Shape) -> wire.ObservedObject:
    """A thing that stands or lies in the cell.

    Args:
        name: its id, the same in every frame.
        kind: "fragile" where harm to it matters as to a glass.
        shape: by `ball`, `rod`, `box` or `hull`.

    Raises:
        SensorError: `SIGHT_MALFORMED`.
    """
    if kind not in wire.OBJECT_KINDS:
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"{str(kind)[:32]!r} is no kind", "Take fragile or rigid.")
    return wire.ObservedObject(name, kind, shape)


def _um(place_m: Place) -> wire.Point:
    x, y, z = (round(each * Unit.MICROMETRE.per_si) for each in place_m)
    return x, y, z


def _size_um(length_m: float) -> int:
    """Length in whole micrometres, rounded up: nothing gets thinner."""
    return max(1, math.ceil(length_m * Unit.MICROMETRE.per_si - 1e-6))  # 0.29 m is 290000.00000000006


def _middle_um(shape: wire.Capsule | wire.Sphere) -> tuple[float, float]:
    if isinstance(shape, wire.Sphere):
        return shape.center_um[0], shape.center_um[1]
    return (shape.a_um[0] + shape.b_um[0]) / 2, (shape.a_um[1] + shape.b_um[1]) / 2

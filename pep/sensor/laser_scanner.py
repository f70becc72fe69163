"""A safety laser scanner's fields: while a field is entered, a person is anywhere in it.

Field bits say that something is there, and nothing more. So the whole field counts as a person, upright, arms unseen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

from pep.sensor.detections import TALL_M
from pep.sensor.metres import FAR_M, IN_METRES, PersonSight, number, rod
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.statements.observation import Capsule

PILLARS: Final = 60
"""Most upright rods of one field, of the 64 regions that a person may have."""
LEAST_CELL_M: Final = 0.2
"""Least side of the squares that a field is laid out in. Ours."""
REACH_M: Final = 1.2
"""Reach over a scan plane at the floor.

C = 1.2 m - 0.4 H, at least 0.85 m (ISO 13855, parallel approach).
"""
REACH_PER_HEIGHT: Final = 0.4
LEAST_REACH_M: Final = 0.85
"""Part of that reach which physics adds to a person without arm regions (docs/physics.md PHY-3)."""


@dataclass(frozen=True)
class ScannerField:
    """One field of a laser scanner, as its configuration has it, in the robot's base frame.

    Attributes:
        name: id of the person in it.
        outline_m: its corners x, y in order, at least three.
        floor_z_m: height of the floor.
        plane_m: height of the scan plane above the floor.
        error_m: by which the field's edge may be elsewhere.
    """

    name: str
    outline_m: Sequence[Sequence[float]]
    floor_z_m: float
    plane_m: float
    error_m: float = 0.10

    def __post_init__(self) -> None:
        corners = [tuple(number(each, f"a corner of {self.name}") for each in corner) for corner in self.outline_m]
        if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
            raise SensorError(
                SensorFault.SIGHT_MALFORMED, f"the outline of {self.name[:64]}", "Give three corners x, y or more."
            )
        numbers = (*(each for corner in corners for each in corner), self.floor_z_m, self.plane_m, self.error_m)
        if not max(abs(number(each, self.name)) for each in numbers) <= FAR_M:
            raise SensorError(SensorFault.NOT_METRES, f"{self.name[:64]} reaches beyond {FAR_M:g} m", IN_METRES)
        if not (_area_m2(corners) >= LEAST_CELL_M**2 and self.plane_m >= 0 and self.error_m >= 0):
            raise SensorError(
                SensorFault.SIGHT_MALFORMED, f"{self.name[:64]} has no area, or a size below 0", "Check its corners."
            )

    @cached_property
    def sight(self) -> PersonSight:
        """A person anywhere in the field, as upright rods that cover it."""
        reach_m = max(0.0, REACH_M - REACH_PER_HEIGHT * self.plane_m - LEAST_REACH_M)
        side = max(LEAST_CELL_M, math.sqrt(_area_m2(self.outline_m) / PILLARS))
        while len(places := self._cells(side)) > PILLARS:
            side *= 1.25
        radius_m = side / math.sqrt(2) + reach_m + self.error_m
        return PersonSight(
            tuple(("head", self._pillar(at, radius_m)) for at in places), self.name, unseen=("place in it",)
        )

    def _pillar(self, at: tuple[float, float], radius_m: float) -> Capsule:
        return rod((*at, self.floor_z_m), (*at, self.floor_z_m + TALL_M), radius_m)

    def _cells(self, side: float) -> list[tuple[float, float]]:
        """Middles of the squares of that side that the field reaches into, or more than are needed."""
        corners = [(float(x), float(y)) for x, y in self.outline_m]
        low = [min(axis) for axis in zip(*corners, strict=True)]
        counts = [max(1, math.ceil((max(a) - min(a)) / side)) for a in zip(*corners, strict=True)]
        middles = [
            (low[0] + (i + 0.5) * side, low[1] + (j + 0.5) * side) for i in range(counts[0]) for j in range(counts[1])
        ]
        return [at for at in middles if _apart_m(at, corners) <= side / math.sqrt(2)]


def entered(fields: Sequence[ScannerField], bits: Sequence[int], *, clear: int = 1) -> list[PersonSight]:
    """A person in each field that is entered.

    Args:
        fields: all of the scanner.
        bits: one of each field, in the same order, each 0 or 1.
        clear: value of a bit whose field is clear; 1 as of safe outputs, so that a broken wire counts as entered.

    Raises:
        SensorError: `SIGHT_MALFORMED` for a bit that is missing or none.
    """
    if len(bits) != len(fields) or any(bit not in (0, 1) for bit in bits) or clear not in (0, 1):
        raise SensorError(
            SensorFault.SIGHT_MALFORMED, f"{len(bits)} bits for {len(fields)} fields", "Give 0 or 1 for each field."
        )
    return [each.sight for each, bit in zip(fields, bits, strict=True) if bit != clear]


def _area_m2(corners: Sequence[Sequence[float]]) -> float:
    ahead = (*corners[1:], corners[0])
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, ahead, strict=True))) / 2


def _apart_m(point: tuple[float, float], corners: Sequence[tuple[float, float]]) -> float:
    """Distance of a point from an outline's area; 0 inside."""
    x, y = point
    inside, least = False, math.inf
    for (ax, ay), (bx, by) in zip(corners, (*corners[1:], corners[0]), strict=True):
        if (ay > y) != (by > y) and x < (bx - ax) * (y - ay) / (by - ay) + ax:
            inside = not inside
        squared = (bx - ax) ** 2 + (by - ay) ** 2
        share = 0.0 if squared == 0 else min(1.0, max(0.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / squared))
        least = min(least, math.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)))
    return 0.0 if inside else least

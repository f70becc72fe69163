"""A calibrated camera: where its pixels with depth, and points of its own frame, are in the robot's base frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Final

from pep.sensor.metres import length, number, place
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.sensor.metres import Place

TURN_SLACK: Final = 1e-3
"""Largest error of a rotation matrix's products, as of one that was written with four digits. Ours."""
IDENTITY: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with its extrinsics. Its own frame: x to the right, y down, z forward (optical, ROS REP 103).

    Attributes:
        position_m: of its optical centre, in the base frame.
        rotation: 3 x 3, rows in order: takes directions of the camera's frame to the base frame.
        fx, fy, cx, cy: intrinsics in pixels; 0 for a camera that gives points and no pixels.
    """

    position_m: Sequence[float]
    rotation: Sequence[Sequence[float]]
    fx: float = 0.0
    fy: float = 0.0
    cx: float = 0.0
    cy: float = 0.0

    def __post_init__(self) -> None:
        place(self.position_m, "position_m")
        rows = [place(row, "a row of rotation") for row in self.rotation]
        if len(rows) != 3 or not _turns(rows):
            raise SensorError(
                SensorFault.SIGHT_MALFORMED,
                "rotation is none",
                "Give three rows at right angles, of a right-handed turn.",
            )
        for name in ("fx", "fy", "cx", "cy"):
            if not number(getattr(self, name), name) >= 0:
                raise SensorError(SensorFault.SIGHT_MALFORMED, f"{name} is negative", "Give pixels, from the corner.")

    @classmethod
    def posed(cls, matrix: Sequence[Sequence[float]], intrinsics: Sequence[Sequence[float]] = IDENTITY) -> Camera:
        """Camera by its 4 x 4 pose in the base frame, and its 3 x 3 intrinsics."""
        rows = [[number(each, "the pose") for each in row] for row in matrix]
        inside = [[number(each, "the intrinsics") for each in row] for row in intrinsics]
        if [len(row) for row in rows] != [4] * 4 or rows[3] != [0, 0, 0, 1] or [len(row) for row in inside] != [3] * 3:
            raise SensorError(
                SensorFault.SIGHT_MALFORMED, "the pose or the intrinsics", "Give 4 x 4 with 0 0 0 1 last, and 3 x 3."
            )
        x, y, z = (row[3] for row in rows[:3])
        return cls((x, y, z), [row[:3] for row in rows[:3]], inside[0][0], inside[1][1], inside[0][2], inside[1][2])

    def point(self, u: float, v: float, depth_m: float | None) -> Place:
        """Point of the camera's own frame that a pixel with its depth is.

        Args:
            u: pixel to the right.
            v: pixel down.
            depth_m: distance along the optical axis, as depth images have it.

        Raises:
            SensorError: `NO_DEPTH` for a depth of 0 or none; `NOT_METRES`; as `metres.number`.
        """
        if not (self.fx > 0 and self.fy > 0):
            raise SensorError(SensorFault.SIGHT_MALFORMED, "a pixel of a camera without fx, fy", "Give its intrinsics.")
        given: object = depth_m
        if given is None or given == 0 or (isinstance(given, Real) and math.isnan(given)):
            raise SensorError(
                SensorFault.NO_DEPTH, f"no depth was measured at ({u:g}, {v:g})", "Say None for that point."
            )
        depth = length(depth_m, "a depth")
        right, down = (number(u, "u") - self.cx) / self.fx * depth, (number(v, "v") - self.cy) / self.fy * depth
        return right, down, depth

    def in_base(self, point_m: Sequence[float]) -> Place:
        """A point of the camera's own frame, in the base frame."""
        x, y, z = place(point_m, "a point")
        a, b, c = (
            row[0] * x + row[1] * y + row[2] * z + at for row, at in zip(self.rotation, self.position_m, strict=True)
        )
        return a, b, c

    def behind(self, point_m: Sequence[float], by_m: float) -> Place:
        """Place in the base frame, so far behind a point of the camera's own frame as it sees it."""
        x, y, z = place(point_m, "a point")
        away = math.hypot(x, y, z)
        if away == 0:
            raise SensorError(SensorFault.NO_DEPTH, "a point is (0, 0, 0)", "Say None for what is not seen.")
        return self.in_base(tuple(each * (1 + by_m / away) for each in (x, y, z)))


def checked_pixels(pixels: Sequence[float]) -> tuple[float, float, float, float]:
    """The corners u0, v0, u1, v1 of a box in an image, in order."""
    found = [number(each, "a pixel") for each in pixels]
    if len(found) != 4 or not (found[0] < found[2] and found[1] < found[3]):
        raise SensorError(SensorFault.SIGHT_MALFORMED, "a box of pixels", "Give u0 < u1 and v0 < v1 as u0, v0, u1, v1.")
    u0, v0, u1, v1 = found
    return u0, v0, u1, v1


def _turns(rows: Sequence[Place]) -> bool:
    """True for a rotation: rows of length one, at right angles, right-handed."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    handed = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    products = [
        abs(sum(p * q for p, q in zip(rows[one], rows[other], strict=True)) - (one == other))
        for one in range(3)
        for other in range(one, 3)
    ]
    return max(products) <= TURN_SLACK and abs(handed - 1) <= TURN_SLACK

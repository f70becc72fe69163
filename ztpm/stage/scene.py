"""Scenes for the sensor: a person, a point in front of the arm, a glass under its way."""

from __future__ import annotations

from typing import Final

GLASS: Final = {"id": "glass-1", "kind": "fragile"}
PERSON_AXIS_M: Final = 0.69
"""Body axis of a standing adult 0.5 m from the base axis, by its torso of radius 0.19 m: C2."""


def person(identity: str, x_m: float, y_m: float) -> dict[str, object]:
    """A standing adult for the sensor, by the position of the body axis in the base frame."""
    return {"id": identity, "x_m": x_m, "y_m": y_m}


MIDDLE_M: Final = (-0.272, -0.131)
"""Place of the tool in the middle of the sweep: x, y in the base frame, by forward kinematics."""


def front(radius_m: float) -> tuple[float, float]:
    """The point at that distance from the base axis in the direction of the middle of the sweep, base frame."""
    x, y = MIDDLE_M
    norm = (x * x + y * y) ** 0.5
    return radius_m * x / norm, radius_m * y / norm


def under_the_path() -> dict[str, object]:
    """A fragile glass standing on the table under the middle of the sweep (condition C1)."""
    x, y = MIDDLE_M
    return {**GLASS, "shape": {"type": "capsule", "a_m": [x, y, 0.03], "b_m": [x, y, 0.10], "radius_m": 0.035}}

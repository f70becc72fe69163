"""A standing adult as nine body regions, for the sensor simulator and for tests.

Sizes are placeholders with names: a real sensor brings its own. Heights are above the floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pep.pit.scene.scene import Capsule, Person, Region, Sphere

if TYPE_CHECKING:
    from pep.pit.scene.scene import Vector

_HALF_TURN = math.pi


@dataclass(frozen=True, slots=True)
class Build:
    """Sizes of the placeholder adult, metres; each is a stand-in chosen to be large, none is anthropometric data."""

    floor_z_m: float = -0.8  # placeholder: base flange on a table of 0.8 m
    head_height_m: float = 1.62  # placeholder
    head_radius_m: float = 0.13  # placeholder
    neck_low_m: float = 1.42  # placeholder
    neck_high_m: float = 1.48  # placeholder
    neck_radius_m: float = 0.08  # placeholder
    torso_low_m: float = 1.05  # placeholder
    torso_high_m: float = 1.35  # placeholder
    torso_radius_m: float = 0.19  # placeholder
    abdomen_low_m: float = 0.95  # placeholder
    abdomen_high_m: float = 1.05  # placeholder
    abdomen_radius_m: float = 0.18  # placeholder
    pelvis_low_m: float = 0.85  # placeholder
    pelvis_high_m: float = 0.95  # placeholder
    pelvis_radius_m: float = 0.18  # placeholder
    arm_low_m: float = 0.80  # placeholder: hanging arms, hands included
    arm_high_m: float = 1.30  # placeholder
    arm_radius_m: float = 0.06  # placeholder
    arm_aside_m: float = 0.24  # placeholder
    leg_low_m: float = 0.10  # placeholder
    leg_high_m: float = 0.80  # placeholder
    leg_radius_m: float = 0.12  # placeholder
    leg_aside_m: float = 0.10  # placeholder


DEFAULT_BUILD = Build()


def standing_adult(
    x_m: float,
    y_m: float,
    *,
    facing_rad: float = 0.0,
    name: str = "person",
    build: Build = DEFAULT_BUILD,
) -> Person:
    """An adult whose body axis stands at (x_m, y_m), looking along `facing_rad` (about z, from x)."""
    cos, sin = math.cos(facing_rad), math.sin(facing_rad)

    def at(aside_m: float, height_m: float) -> Vector:
        return (x_m - sin * aside_m, y_m + cos * aside_m, build.floor_z_m + height_m)

    def upright(aside_m: float, low_m: float, high_m: float, radius_m: float) -> Capsule:
        return Capsule(at(aside_m, low_m), at(aside_m, high_m), radius_m)

    b = build
    return Person(
        name,
        (
            (Region.HEAD, Sphere(at(0, b.head_height_m), b.head_radius_m)),
            (Region.NECK, upright(0, b.neck_low_m, b.neck_high_m, b.neck_radius_m)),
            (Region.TORSO, upright(0, b.torso_low_m, b.torso_high_m, b.torso_radius_m)),
            (Region.ABDOMEN, upright(0, b.abdomen_low_m, b.abdomen_high_m, b.abdomen_radius_m)),
            (Region.PELVIS, upright(0, b.pelvis_low_m, b.pelvis_high_m, b.pelvis_radius_m)),
            (Region.LOWER_ARM, upright(b.arm_aside_m, b.arm_low_m, b.arm_high_m, b.arm_radius_m)),
            (Region.LOWER_ARM, upright(-b.arm_aside_m, b.arm_low_m, b.arm_high_m, b.arm_radius_m)),
            (Region.THIGH, upright(b.leg_aside_m, b.leg_low_m, b.leg_high_m, b.leg_radius_m)),
            (Region.THIGH, upright(-b.leg_aside_m, b.leg_low_m, b.leg_high_m, b.leg_radius_m)),
        ),
    )


def adult_at_distance(
    surface_m: float,
    *,
    bearing_rad: float,
    name: str = "person",
    build: Build = DEFAULT_BUILD,
) -> Person:
    """An adult facing the base in direction `bearing_rad`.

    The nearest body surface is `surface_m` from the base axis.

    "A person 0.5 m from the base" means this distance: from body surface to the z axis.
    """
    parts = (
        (0.0, b_radius)
        for b_radius in (build.head_radius_m, build.torso_radius_m, build.abdomen_radius_m, build.pelvis_radius_m)
    )
    aside = ((build.arm_aside_m, build.arm_radius_m), (build.leg_aside_m, build.leg_radius_m))
    # Every part is upright: one `aside` of the body axis touches the cylinder when the body axis is this far out.
    needed = (math.sqrt(max((surface_m + radius) ** 2 - off**2, 0)) for off, radius in (*parts, *aside))
    out_m = max(needed)
    return standing_adult(
        out_m * math.cos(bearing_rad),
        out_m * math.sin(bearing_rad),
        facing_rad=bearing_rad + _HALF_TURN,
        name=name,
        build=build,
    )

"""Standing adult as the referee sees one: slices of elliptic section, one body region each, and what a region bears.

The adult is a man of mean size. Heights are shares of stature by Drillis and Contini (1966), as Winter, Biomechanics
and Motor Control of Human Movement, prints them (D); breadths, depths and girths are the means of 4,082 men of ANSUR II
(Gordon et al., NATICK/TR-15/007, 2014) (A). What neither tells is marked as chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from evaluation.redteam.referee.shapes import Hull, Vector

STATURE_M: Final = 1.756  # A
CORNERS: Final = 24  # chosen: an ellipse's polygon lies at most 1 % of its radius inside


class Region(StrEnum):
    """Body regions of ISO/TS 15066, annex A; the trunk's front and back are one, with the weaker one's limit."""

    SKULL = "skull"
    FACE = "face"
    NECK = "neck"
    CHEST = "chest"
    ABDOMEN = "abdomen"
    PELVIS = "pelvis"
    UPPER_ARM = "upper_arm"
    LOWER_ARM = "lower_arm"
    HAND = "hand"
    THIGH = "thigh"
    LOWER_LEG = "lower_leg"


@dataclass(frozen=True, slots=True)
class Bears:
    """Limits of a region in a transient contact.

    Attributes:
        force_n: quasi-static limit.
        transient: factor of a transient contact; 0 where none is permissible.
        spring_n_m: effective spring.
        mass_kg: effective mass.
    """

    force_n: float
    transient: float
    spring_n_m: float
    mass_kg: float


BEARS: Final = {
    # ISO/TS 15066:2016 tables A.2 (force, factor) and A.3 (spring, mass), as an open-source UR safety controller and
    # Kirschner et al. (2024) restate them; the standard itself is sold
    Region.SKULL: Bears(130, 0, 150e3, 4.4),
    Region.FACE: Bears(65, 0, 75e3, 4.4),
    Region.NECK: Bears(150, 2, 50e3, 1.2),
    Region.CHEST: Bears(140, 2, 25e3, 40),
    Region.ABDOMEN: Bears(110, 2, 10e3, 40),
    Region.PELVIS: Bears(180, 2, 25e3, 40),
    Region.UPPER_ARM: Bears(150, 2, 30e3, 3),
    Region.LOWER_ARM: Bears(160, 2, 40e3, 2),
    Region.HAND: Bears(140, 2, 75e3, 0.6),
    Region.THIGH: Bears(220, 2, 50e3, 75),
    Region.LOWER_LEG: Bears(130, 2, 60e3, 75),
}


def transient_m_s(region: Region, *, arm_kg: float) -> float:
    """Speed above which a blow exceeds a region's transient limit: F / sqrt(mu k), ISO/TS 15066 A.3.4.

    Args:
        region: that is hit.
        arm_kg: effective mass of the arm, half its moving mass and the whole load.
    """
    bears = BEARS[region]
    reduced_kg = 1 / (1 / bears.mass_kg + 1 / arm_kg)
    return bears.transient * bears.force_n / math.sqrt(reduced_kg * bears.spring_n_m)


@dataclass(frozen=True, slots=True)
class Slice:
    """Upright part of a body.

    Attributes:
        region: that it belongs to.
        breadth_m, depth_m: whole axes of its section, across and along the way that the person faces.
        low, high: heights of its ends as shares of stature.
        aside_m: how far to the left of the body's axis.
    """

    region: Region
    breadth_m: float
    depth_m: float
    low: float
    high: float
    aside_m: float = 0.0

    def hull(self, floor_z_m: float) -> Hull:
        """The slice of a person who stands at the origin and faces along x."""
        turn = [2 * math.pi * n / CORNERS for n in range(CORNERS)]
        ring = [(self.depth_m / 2 * math.cos(a), self.aside_m + self.breadth_m / 2 * math.sin(a)) for a in turn]
        heights = [floor_z_m + share * STATURE_M for share in (self.low, self.high)]
        points: list[Vector] = [(x, y, z) for z in heights for x, y in ring]
        return Hull(tuple(points))


def _round(region: Region, girth_m: float, low: float, high: float, aside_m: float = 0.0) -> Slice:
    return Slice(region, girth_m / math.pi, girth_m / math.pi, low, high, aside_m)


_BICEPS_M: Final = 0.358  # A: girth, flexed
_WRIST_M: Final = 0.176  # A: girth
_THIGH_M: Final = 0.625  # A: girth
_CALF_M: Final = 0.373  # A: girth
_ARM_ASIDE_M: Final = 0.510 / 2 - _BICEPS_M / (2 * math.pi)  # A: bideltoid breadth 510 mm, arms hanging
_LEG_ASIDE_M: Final = _THIGH_M / (2 * math.pi)  # chosen: thighs that touch

ADULT: Final = (
    Slice(Region.SKULL, 0.154, 0.199, 0.936, 1.0),  # A: head breadth, length; D: eyes, crown
    Slice(Region.FACE, 0.154, 0.199, 0.870, 0.936),  # A; D: chin, eyes
    _round(Region.NECK, 0.398, 0.818, 0.870),  # A: girth; D: shoulder, chin
    Slice(
        Region.CHEST, 0.289, 0.254, 0.650, 0.818
    ),  # A: chest breadth, depth; low end chosen: lowest ribs; D: shoulder
    Slice(Region.ABDOMEN, 0.326, 0.238, 0.580, 0.650),  # A: waist breadth, depth; ends chosen
    Slice(Region.PELVIS, 0.346, 0.246, 0.482, 0.580),  # A: hip breadth, buttock depth, crotch height; high end chosen
    *(
        one
        for side in (-1, 1)
        for one in (
            _round(Region.UPPER_ARM, _BICEPS_M, 0.630, 0.818, side * _ARM_ASIDE_M),  # D: elbow, shoulder
            # chosen: midway between biceps and wrist; D: wrist, elbow
            _round(Region.LOWER_ARM, (_BICEPS_M + _WRIST_M) / 2, 0.485, 0.630, side * _ARM_ASIDE_M),
            Slice(Region.HAND, 0.030, 0.088, 0.377, 0.485, side * _ARM_ASIDE_M),  # A: hand breadth; thickness chosen; D
            _round(Region.THIGH, _THIGH_M, 0.285, 0.482, side * _LEG_ASIDE_M),  # D: knee; A: crotch height
            _round(Region.LOWER_LEG, _CALF_M, 0.039, 0.285, side * _LEG_ASIDE_M),  # D: ankle, knee
        )
    ),
)

"""Shapes that the referee knows: hulls of a few points, grown by a radius, about a centre of their own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]
Vector: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Ball:
    """Ball about its centre, metre."""

    radius_m: float


@dataclass(frozen=True, slots=True)
class Block:
    """Box about its centre, by half its edges, metre."""

    half_m: Vector


@dataclass(frozen=True, slots=True)
class Rod:
    """Capsule from minus to plus an arrow about its centre, metre."""

    arrow_m: Vector
    radius_m: float


@dataclass(frozen=True, slots=True)
class Hull:
    """Convex hull of points, grown by a radius, metre."""

    points_m: tuple[Vector, ...]
    radius_m: float = 0.0
    corners_m: Floats = field(init=False, repr=False, compare=False)
    """The same points as an array, made once."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners_m", np.array(self.points_m, dtype=np.float64))


Shape: TypeAlias = Ball | Block | Rod | Hull


@dataclass(frozen=True, slots=True)
class Standing:
    """Shape at a place in the robot's base frame, upright.

    Attributes:
        shape: of it.
        center_m: place of the shape's centre.
    """

    shape: Shape
    center_m: Vector

    @classmethod
    def block(cls, low_m: Vector, high_m: Vector) -> Standing:
        """Box between two opposite corners."""
        low, high = np.array(low_m), np.array(high_m)
        x, y, z = ((low + high) / 2).tolist()
        a, b, c = ((high - low) / 2).tolist()
        return cls(Block((a, b, c)), (x, y, z))


def outline(shape: Shape) -> tuple[Floats, float]:
    """Points whose hull, grown by the radius, is the shape: shape (n, 3), and the radius."""
    match shape:
        case Ball(radius):
            return np.zeros((1, 3)), radius
        case Block(half):
            signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
            return signs * np.array(half), 0.0
        case Rod(arrow, radius):
            return np.array([arrow, arrow]) * np.array([[-1.0], [1.0]]), radius
        case Hull():
            return shape.corners_m, shape.radius_m


def bounds(shape: Shape) -> tuple[Floats, Floats]:
    """Middle and half edges of the box around a shape, in the shape's own frame."""
    points, radius = outline(shape)
    low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
    return (low + high) / 2, (high - low) / 2

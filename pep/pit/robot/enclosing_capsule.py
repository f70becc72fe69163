"""Capsules around other shapes: every point of the shape is inside, with little room to spare.

Around a body that is long one way and reaches `across` from that line, a capsule may stop short of the ends by x when
its radius grows to sqrt(across^2 + x^2). The volume has one minimum in x between 0 and the half length; a body much
wider than long gets a ball.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np
import pinocchio

from pep.pit.robot.urdf import UrdfBox, UrdfCylinder, UrdfSphere

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.robot.model import Vector
    from pep.pit.robot.urdf import Pose, Shape

HALVINGS: Final = 60  # of an interval of the half length: to the last bit
ROUNDING_M: Final = 1e-9  # on every radius, so that no corner is lost by rounding


def capsule_around(pose: Pose, shape: Shape) -> tuple[Floats, Floats, float]:
    """Both ends of the axis, in the frame that the pose is in, and the radius; metre."""
    rotation, center = pinocchio.rpy.rpyToMatrix(*pose.rpy_rad), np.array(pose.xyz_m)
    match shape:
        case UrdfSphere(radius_m):
            half, radius, along = 0.0, radius_m, rotation[:, 2]
        case UrdfCylinder(radius_m, length_m, True):
            half, radius, along = 0.5 * length_m, radius_m, rotation[:, 2]
        case UrdfCylinder(radius_m, length_m, _):
            half, radius = _shorter(0.5 * length_m, radius_m)
            along = rotation[:, 2]
        case UrdfBox(size_m):
            longest, across = _edges(size_m)
            half, radius = _shorter(0.5 * size_m[longest], across)
            along = rotation[:, longest]
        case _:
            assert_never(shape)
    return center - half * along, center + half * along, radius + ROUNDING_M


def capsule_around_points(points: Floats) -> tuple[Floats, Floats, float]:
    """Ends and radius of a capsule that contains these points, (n, 3).

    Along their longest way or a principal axis.

    Of the four the one with the smallest volume counts. A radius around each point is added to the capsule's.
    """
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    one, other = np.unravel_index(int(apart.argmax()), apart.shape)
    _, _, principal = np.linalg.svd(points - points.mean(axis=0))
    ways = [(points[other] - points[one]) / apart[one, other], *principal]
    return min((capsule_along(points, way) for way in ways), key=volume_m3)


def capsule_along(points: Floats, way: Floats) -> tuple[Floats, Floats, float]:
    """The smallest capsule about these points in this direction, its axis through the middle of their ranges."""
    _, _, frame = np.linalg.svd(way[None])
    frame[0] = way
    local = points @ frame.T
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    half_m = 0.5 * float(np.ptp(local[:, 0]))
    half, radius = _shorter(half_m, float(np.linalg.norm(local[:, 1:] - middle[1:], axis=1).max()))
    center = middle @ frame
    return center - half * way, center + half * way, radius + ROUNDING_M


def volume_m3(capsule: tuple[Floats, Floats, float]) -> float:
    """Volume of a capsule, cubic metre."""
    a, b, radius = capsule
    return math.pi * radius**2 * (float(np.linalg.norm(b - a)) + 4 / 3 * radius)


def _edges(size_m: Vector) -> tuple[int, float]:
    """Longest edge of a box, and the distance of its corners from the middle line along it."""
    longest = max(range(3), key=lambda k: size_m[k])
    one, other = (0.5 * size_m[k] for k in range(3) if k != longest)
    return longest, math.hypot(one, other)


def _shorter(half_m: float, across_m: float) -> tuple[float, float]:
    """Half length and radius of the smallest capsule about a body of this half length and reach across.

    With r(x)^2 = across^2 + x^2 the slope of its volume 2 pi r^2 (half - x) + 4/3 pi r^3, over 2 pi, is
    2 x (half - x) + 2 x r - r^2: below 0 at x = 0, and rising.
    """
    low, high = 0.0, half_m
    for _ in range(HALVINGS):
        x = 0.5 * (low + high)
        radius = math.hypot(across_m, x)
        if 2 * x * (half_m - x) + 2 * x * radius - radius**2 < 0:
            low = x
        else:
            high = x
    return half_m - low, math.hypot(across_m, low)

"""Positions, rotations and poses in plain floats, for use 500 times a second without an array library.

A rotation is nine floats, row by row. A pose is six: metres, then a rotation vector in radians, as UR writes it.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

Triple: TypeAlias = tuple[float, float, float]
Rotation: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
Frame: TypeAlias = tuple[Triple, Rotation]

IDENTITY: Final[Rotation] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def compose(a: Rotation, b: Rotation) -> Rotation:
    """The rotation that does `b`, then `a`."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )


def rotate(r: Rotation, v: Triple) -> Triple:
    """`v` turned by `r`."""
    x, y, z = v
    return (r[0] * x + r[1] * y + r[2] * z, r[3] * x + r[4] * y + r[5] * z, r[6] * x + r[7] * y + r[8] * z)


def transpose(r: Rotation) -> Rotation:
    """The inverse of a rotation."""
    return (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8])


def add(a: Triple, b: Triple) -> Triple:
    """The sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def cross(a: Triple, b: Triple) -> Triple:
    """The vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def chain(a: Frame, b: Frame) -> Frame:
    """Frame `b`, given in `a`, as seen from where `a` is given."""
    return add(a[0], rotate(a[1], b[0])), compose(a[1], b[1])


def inverse(frame: Frame) -> Frame:
    """The frame that undoes `frame`."""
    back = transpose(frame[1])
    x, y, z = rotate(back, frame[0])
    return (-x, -y, -z), back


def from_vector(v: Triple) -> Rotation:
    """The rotation about `v` by its length in radians."""
    angle = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if angle < 1e-12:
        return IDENTITY
    x, y, z = v[0] / angle, v[1] / angle, v[2] / angle
    c, s = math.cos(angle), math.sin(angle)
    k = 1.0 - c
    return (
        c + x * x * k,
        x * y * k - z * s,
        x * z * k + y * s,
        y * x * k + z * s,
        c + y * y * k,
        y * z * k - x * s,
        z * x * k - y * s,
        z * y * k + x * s,
        c + z * z * k,
    )


def to_vector(r: Rotation) -> Triple:
    """Rotation vector of `r`, its length in [0, pi].

    It is computed by the quaternion, so it is exact near 0 and near pi alike.
    """
    squares = (1.0 + r[0] + r[4] + r[8], 1.0 + r[0] - r[4] - r[8], 1.0 - r[0] + r[4] - r[8], 1.0 - r[0] - r[4] + r[8])
    # Each row is 4 * (largest quaternion component) * the quaternion, so no division by something small happens.
    best = max(range(4), key=squares.__getitem__)
    rows = (
        (squares[0], r[7] - r[5], r[2] - r[6], r[3] - r[1]),
        (r[7] - r[5], squares[1], r[1] + r[3], r[2] + r[6]),
        (r[2] - r[6], r[1] + r[3], squares[2], r[5] + r[7]),
        (r[3] - r[1], r[2] + r[6], r[5] + r[7], squares[3]),
    )
    w, x, y, z = rows[best]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-15:
        return (0.0, 0.0, 0.0)
    scale = 2.0 * math.atan2(length, w) / length
    return (x * scale, y * scale, z * scale)


def from_rpy(roll: float, pitch: float, yaw: float) -> Rotation:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    about_z, about_y, about_x = from_vector((0, 0, yaw)), from_vector((0, pitch, 0)), from_vector((roll, 0, 0))
    return compose(about_z, compose(about_y, about_x))


def to_frame(pose: list[float] | tuple[float, ...]) -> Frame:
    """The frame of a pose."""
    x, y, z, rx, ry, rz = pose
    return (x, y, z), from_vector((rx, ry, rz))


def to_pose(frame: Frame) -> tuple[float, ...]:
    """The pose of a frame."""
    return (*frame[0], *to_vector(frame[1]))

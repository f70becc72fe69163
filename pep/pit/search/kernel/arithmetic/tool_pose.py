"""Arm as its tool needs it, one configuration at a time: pose, Jacobian, Newton's method.

The same as `pep.pit.robot.inverse_kinematics` and `pep.pit.robot.twist`, number by number. As there, nothing here is a
proof.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.robot.inverse_kinematics import EXACT, FAR_RAD, STEPS
from pep.pit.robot.twist import SMALL
from pep.pit.search.kernel.arithmetic.compilation import compiled

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats

JOINTS: Final = 6


class Wrist(NamedTuple):
    """Joint frames at angle 0, (6, 3, 3) and (6, 3), and the tool point, (3,), m.

    The tool point is in the last frame.
    """

    rotations: Floats
    offsets: Floats
    tcp: Floats


class KernelTwist(NamedTuple):
    """Constant twist, as `pep.pit.robot.twist.Twist`: its start and its rates by s."""

    position: Floats
    rotation: Floats
    line: Floats
    turn: Floats


class Stand(NamedTuple):
    """Room for one configuration.

    Attributes:
        q: joint angles (6,), rad.
        position, rotation: of the tool, (3,) and (3, 3).
        axes, origins: of the joints, (6, 3).
        jacobian: tool velocity (linear, angular) by joint speeds, (6, 6).
        frame: (2, 3, 3), room for a rotation on the way and one more.
    """

    q: Floats
    position: Floats
    rotation: Floats
    axes: Floats
    origins: Floats
    jacobian: Floats
    frame: Floats


@compiled
def no_stand() -> Stand:
    """Room for one configuration, still empty."""
    return Stand(
        np.empty(JOINTS),
        np.empty(3),
        np.empty((3, 3)),
        np.empty((JOINTS, 3)),
        np.empty((JOINTS, 3)),
        np.empty((JOINTS, JOINTS)),
        np.empty((2, 3, 3)),
    )


@compiled
def stand_at(wrist: Wrist, stand: Stand) -> None:
    """Computes all of `stand` from its `q`."""
    rotations, offsets, q = wrist.rotations, wrist.offsets, stand.q
    axes, origins, rotation, jacobian = stand.axes, stand.origins, stand.rotation, stand.jacobian
    for i in range(3):
        for j in range(3):
            rotation[i, j] = 1.0 if i == j else 0.0
    ox = oy = oz = 0.0
    for k in range(JOINTS):
        a, b, c = offsets[k, 0], offsets[k, 1], offsets[k, 2]
        ox += rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        oy += rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        oz += rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
        cosine, sine = math.cos(q[k]), math.sin(q[k])
        for i in range(3):
            x, y, z = rotation[i, 0], rotation[i, 1], rotation[i, 2]
            u = x * rotations[k, 0, 0] + y * rotations[k, 1, 0] + z * rotations[k, 2, 0]
            v = x * rotations[k, 0, 1] + y * rotations[k, 1, 1] + z * rotations[k, 2, 1]
            rotation[i, 0], rotation[i, 1] = u * cosine + v * sine, v * cosine - u * sine
            rotation[i, 2] = x * rotations[k, 0, 2] + y * rotations[k, 1, 2] + z * rotations[k, 2, 2]
            axes[k, i] = rotation[i, 2]
        origins[k, 0], origins[k, 1], origins[k, 2] = ox, oy, oz
    a, b, c = wrist.tcp[0], wrist.tcp[1], wrist.tcp[2]
    px = ox + rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
    py = oy + rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
    pz = oz + rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
    stand.position[0], stand.position[1], stand.position[2] = px, py, pz
    for k in range(JOINTS):
        x, y, z = axes[k, 0], axes[k, 1], axes[k, 2]
        a, b, c = px - origins[k, 0], py - origins[k, 1], pz - origins[k, 2]
        jacobian[0, k], jacobian[1, k], jacobian[2, k] = y * c - z * b, z * a - x * c, x * b - y * a
        jacobian[3, k], jacobian[4, k], jacobian[5, k] = x, y, z


@compiled
def bend_of(stand: Stand, dq: Floats, bend: Floats) -> None:
    """Writes to `bend` (6, 6) the Jacobian's derivative by s while the joints turn at `dq`."""
    axes, origins, position = stand.axes, stand.origins, stand.position
    px, py, pz = position[0], position[1], position[2]
    vx = vy = vz = 0.0  # of the tool: the Jacobian's linear part
    for k in range(JOINTS):
        vx += stand.jacobian[0, k] * dq[k]
        vy += stand.jacobian[1, k] * dq[k]
        vz += stand.jacobian[2, k] * dq[k]
    wx = wy = wz = cx = cy = cz = 0.0  # spin of the link that carries the axis, and sum of w_j x o_j before it
    for k in range(JOINTS):
        x, y, z = axes[k, 0], axes[k, 1], axes[k, 2]
        ox, oy, oz = origins[k, 0], origins[k, 1], origins[k, 2]
        bx, by, bz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        ux = vx - (wy * oz - wz * oy - cx)
        uy = vy - (wz * ox - wx * oz - cy)
        uz = vz - (wx * oy - wy * ox - cz)
        a, b, c = px - ox, py - oy, pz - oz
        bend[0, k] = by * c - bz * b + y * uz - z * uy
        bend[1, k] = bz * a - bx * c + z * ux - x * uz
        bend[2, k] = bx * b - by * a + x * uy - y * ux
        bend[3, k], bend[4, k], bend[5, k] = bx, by, bz
        tx, ty, tz = x * dq[k], y * dq[k], z * dq[k]
        wx, wy, wz = wx + tx, wy + ty, wz + tz
        cx, cy, cz = cx + ty * oz - tz * oy, cy + tz * ox - tx * oz, cz + tx * oy - ty * ox


@compiled
def turn_by(x: float, y: float, z: float, turn: Floats) -> None:
    """Writes to `turn` (3, 3) the rotation by the vector (x, y, z), rad."""
    angle = math.sqrt(x * x + y * y + z * z)
    first, second = 1.0, 0.0
    if angle >= SMALL:
        half = math.sin(angle / 2) / (angle / 2)
        first, second = math.sin(angle) / angle, 0.5 * half * half
    turn[0, 0], turn[0, 1], turn[0, 2] = -second * (y * y + z * z), second * x * y, second * x * z
    turn[1, 0], turn[1, 1], turn[1, 2] = second * x * y, -second * (x * x + z * z), second * y * z
    turn[2, 0], turn[2, 1], turn[2, 2] = second * x * z, second * y * z, -second * (x * x + y * y)
    turn[0, 1], turn[1, 0] = turn[0, 1] - first * z, turn[1, 0] + first * z
    turn[0, 2], turn[2, 0] = turn[0, 2] + first * y, turn[2, 0] - first * y
    turn[1, 2], turn[2, 1] = turn[1, 2] - first * x, turn[2, 1] + first * x
    for i in range(3):
        turn[i, i] += 1.0


@compiled
def turn_between(goal: Floats, here: Floats, error: Floats) -> None:
    """Writes to `error[3:]` the rotation vector, at most half a turn, that turns `here` into `goal`, both (3, 3)."""
    xx = yy = zz = zy = yz = xz = zx = yx = xy = 0.0
    for j in range(3):
        xx, yy, zz = xx + goal[0, j] * here[0, j], yy + goal[1, j] * here[1, j], zz + goal[2, j] * here[2, j]
        zy, yz = zy + goal[2, j] * here[1, j], yz + goal[1, j] * here[2, j]
        xz, zx = xz + goal[0, j] * here[2, j], zx + goal[2, j] * here[0, j]
        yx, xy = yx + goal[1, j] * here[0, j], xy + goal[0, j] * here[1, j]
    a, b, c = zy - yz, xz - zx, yx - xy
    sine, cosine = 0.5 * math.sqrt(a * a + b * b + c * c), 0.5 * (xx + yy + zz - 1)
    if sine <= SMALL and cosine < 0:
        # Half a turn has no sine: its axis is the only direction that R + 1 leaves.
        x, y, z = xx + 1, yy + 1, zz + 1
        u, v, w = xy, xz, yz  # the matrix is symmetric there
        if x >= y and x >= z:
            a, b, c = x, yx, zx
        elif y >= z:
            a, b, c = u, y, zy
        else:
            a, b, c = v, w, z
        size = math.pi / math.sqrt(a * a + b * b + c * c)
        error[3], error[4], error[5] = size * a, size * b, size * c
        return
    scale = 0.5
    if sine > SMALL:
        scale = 0.5 * math.atan2(sine, cosine) / sine
    error[3], error[4], error[5] = scale * a, scale * b, scale * c


@compiled
def goal_at(line: KernelTwist, s: float, position: Floats, rotation: Floats, room: Floats) -> None:
    """Writes the line's pose at `s` to `position` (3,) and `rotation` (3, 3); `room` is (3, 3)."""
    turn_by(s * line.turn[0], s * line.turn[1], s * line.turn[2], room)
    for i in range(3):
        position[i] = line.position[i] + s * line.line[i]
        for j in range(3):
            rotation[i, j] = (
                room[i, 0] * line.rotation[0, j] + room[i, 1] * line.rotation[1, j] + room[i, 2] * line.rotation[2, j]
            )


@compiled
def pivot_of(matrix: Floats, k: int) -> int:
    """Row from `k` on with the largest entry in column `k` of `matrix` (6, 6).

    -1 where all are 0.
    """
    best, pivot = abs(matrix[k, k]), k
    for i in range(k + 1, JOINTS):
        if abs(matrix[i, k]) > best:
            best, pivot = abs(matrix[i, k]), i
    return pivot if best > 0.0 else -1


@compiled
def divided(matrix: Floats, right: Floats) -> bool:
    """Writes to `right` (6,) the solution of `matrix` (6, 6), which is used up; False where there is none."""
    for k in range(JOINTS):
        pivot = pivot_of(matrix, k)
        if pivot < 0:
            return False
        if pivot != k:
            for j in range(k, JOINTS):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        one = 1.0 / matrix[k, k]
        for i in range(k + 1, JOINTS):
            share = matrix[i, k] * one
            for j in range(k + 1, JOINTS):
                matrix[i, j] -= share * matrix[k, j]
            right[i] -= share * right[k]
    for k in range(JOINTS - 1, -1, -1):
        rest = right[k]
        for j in range(k + 1, JOINTS):
            rest -= matrix[k, j] * right[j]
        right[k] = rest / matrix[k, k]
    return True


@compiled
def inverted(matrix: Floats, inverse: Floats, room: Floats) -> bool:
    """Writes to `inverse` (6, 6) that of `matrix` (6, 6); False where there is none. `room` is (6, 6)."""
    for i in range(JOINTS):
        for j in range(JOINTS):
            room[i, j], inverse[i, j] = matrix[i, j], 1.0 if i == j else 0.0
    for k in range(JOINTS):
        pivot = pivot_of(room, k)
        if pivot < 0:
            return False
        if pivot != k:
            for j in range(JOINTS):
                room[k, j], room[pivot, j] = room[pivot, j], room[k, j]
                inverse[k, j], inverse[pivot, j] = inverse[pivot, j], inverse[k, j]
        one = 1.0 / room[k, k]
        for j in range(JOINTS):
            room[k, j] *= one
            inverse[k, j] *= one
        for i in range(JOINTS):
            share = room[i, k]
            if i != k:
                for j in range(JOINTS):
                    room[i, j] -= share * room[k, j]
                    inverse[i, j] -= share * inverse[k, j]
    return True


@compiled
def solved(wrist: Wrist, line: KernelTwist, s: float, stand: Stand, room: Floats) -> bool:
    """Moves `stand` by Newton's method to the pose of `line` at `s`; False where it does not arrive.

    Args:
        wrist: the arm.
        line: the tool's.
        s: place on it.
        stand: holds joint angles nearby.
        room: (8, 6) at least.
    """
    goal, turned = stand.frame[0], stand.frame[1]
    error, place, matrix = room[6], room[7, :3], room[:6]
    goal_at(line, s, place, goal, turned)
    q = stand.q
    for _ in range(STEPS):
        stand_at(wrist, stand)
        for i in range(3):
            error[i] = place[i] - stand.position[i]
        turn_between(goal, stand.rotation, error)
        near = True
        for i in range(JOINTS):
            near = near and abs(error[i]) <= EXACT
        if near:
            return True
        for i in range(JOINTS):
            for j in range(JOINTS):
                matrix[i, j] = stand.jacobian[i, j]
        if not divided(matrix, error):
            return False
        for i in range(JOINTS):
            if not abs(error[i]) <= FAR_RAD:
                return False
        for i in range(JOINTS):
            q[i] += error[i]
    return False

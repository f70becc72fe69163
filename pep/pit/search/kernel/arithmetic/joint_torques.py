"""Torques of every joint at many configurations: the recursion of Newton and Euler, several places at once.

Out along the arm go angular velocity w, its derivative, and the acceleration of each joint's origin; back come the
force and the moment that each link needs and passes on (Luh, Walker, Paul 1980). Torque is linear in gravity, in the
joints' accelerations and in what their rates alone do, so three runs are all that any timing of a path needs.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.search.kernel.arithmetic.compilation import LANES, compiled, entry, lent

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats

JOINTS: Final = 6

# Rows of a joint, one number of each configuration: how its frame is turned in the one before, row by row; its rate and
# that one's derivative; then of each run, to hold, to push and to swing the arm, the force and the moment on its link.
_TURN, _RATE, _CHANGE, _HELD, _PUSHED, _SWUNG, _ROWS = 0, 9, 10, 11, 17, 23, 29
_MOMENT: Final = 3  # rows behind a force
_AXIS: Final = 5  # likewise, of the moment about the joint's own axis
# Rows of what goes out along the arm: acceleration where nothing moves; of a push the change of the angular velocity
# and the acceleration; of a swing angular velocity, its change, and the acceleration.
_LIFT, _PUSH_GROWTH, _PUSH, _SPIN, _GROWTH, _ORIGIN, _STATES = 0, 3, 6, 9, 12, 15, 18


class Masses(NamedTuple):
    """Links as rigid bodies, each in the frame of the joint that carries it.

    Attributes:
        mass: (6,), kg, with all that is fixed to the link.
        com: (6, 3), m.
        inertia: (6, 3, 3) about the centre of mass, kg m^2.
        rotations, offsets: (6, 3, 3) and (6, 3): joint frames at angle 0 in the frame of the one before.
        lift: (3,), m/s^2: what a resting base has to give the arm, gravity upside down.
    """

    mass: Floats
    com: Floats
    inertia: Floats
    rotations: Floats
    offsets: Floats
    lift: Floats


def masses_of(model: Any) -> Masses:
    """Links of a pinocchio model of six joints that each turn about their own z axis."""
    bodies = [model.inertias[k + 1] for k in range(JOINTS)]  # number 0 is the base
    placed = [model.jointPlacements[k + 1] for k in range(JOINTS)]
    return Masses(
        mass=np.array([body.mass for body in bodies]),
        com=np.array([body.lever for body in bodies]),
        inertia=np.array([body.inertia for body in bodies]),
        rotations=np.array([place.rotation for place in placed]),
        offsets=np.array([place.translation for place in placed]),
        lift=-np.array(model.gravity.linear),
    )


@lent
def _cross(a: float, b: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    return b * z - c * y, c * x - a * z, a * y - b * x


@lent
def _back_into(here: Floats, n: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Vector of the previous frame, in that of the joint."""
    return (
        here[n] * x + here[3 * LANES + n] * y + here[6 * LANES + n] * z,
        here[LANES + n] * x + here[4 * LANES + n] * y + here[7 * LANES + n] * z,
        here[2 * LANES + n] * x + here[5 * LANES + n] * y + here[8 * LANES + n] * z,
    )


@lent
def _out_of(here: Floats, n: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Vector of the joint's frame, in the previous one."""
    return (
        here[n] * x + here[LANES + n] * y + here[2 * LANES + n] * z,
        here[3 * LANES + n] * x + here[4 * LANES + n] * y + here[5 * LANES + n] * z,
        here[6 * LANES + n] * x + here[7 * LANES + n] * y + here[8 * LANES + n] * z,
    )


@lent
def _three(rows: Floats, row: int, n: int) -> tuple[float, float, float]:
    return rows[row * LANES + n], rows[(row + 1) * LANES + n], rows[(row + 2) * LANES + n]


@lent
def _turned(rotation: Floats, cosines: Floats, sines: Floats, wide: int, here: Floats) -> None:
    """Rotation of the joint's frame in the previous one."""
    for i in range(3):
        x, y, z, row = rotation[i, 0], rotation[i, 1], rotation[i, 2], 3 * i * LANES
        for n in range(wide):
            c, s = cosines[n], sines[n]
            here[row + n], here[row + LANES + n], here[row + 2 * LANES + n] = x * c + y * s, y * c - x * s, z


@lent
def _held(mass: float, com: Floats, wide: int, here: Floats, out: Floats) -> None:
    """Forces that hold the link at rest, when only the lift is passed on."""
    a, b, c = com[0], com[1], com[2]
    for n in range(wide):
        x, y, z = _three(out, _LIFT, n)
        ox, oy, oz = _back_into(here, n, x, y, z)
        out[_LIFT * LANES + n], out[(_LIFT + 1) * LANES + n], out[(_LIFT + 2) * LANES + n] = ox, oy, oz
        fx, fy, fz = mass * ox, mass * oy, mass * oz
        mx, my, mz = _cross(a, b, c, fx, fy, fz)
        here[_HELD * LANES + n], here[(_HELD + 1) * LANES + n], here[(_HELD + 2) * LANES + n] = fx, fy, fz
        at = (_HELD + _MOMENT) * LANES + n
        here[at], here[at + LANES], here[at + 2 * LANES] = mx, my, mz


@lent
def _pushed(mass: float, com: Floats, inertia: Floats, offset: Floats, wide: int, here: Floats, out: Floats) -> None:
    """Forces on the link for unit changes of rates that are still 0."""
    a, b, c, d, e, f = com[0], com[1], com[2], offset[0], offset[1], offset[2]
    xx, xy, xz, yx, yy, yz = inertia[0, 0], inertia[0, 1], inertia[0, 2], inertia[1, 0], inertia[1, 1], inertia[1, 2]
    zx, zy, zz = inertia[2, 0], inertia[2, 1], inertia[2, 2]
    for n in range(wide):
        gx, gy, gz = _three(out, _PUSH_GROWTH, n)
        ox, oy, oz = _three(out, _PUSH, n)
        x, y, z = _cross(gx, gy, gz, d, e, f)
        ox, oy, oz = _back_into(here, n, x + ox, y + oy, z + oz)
        gx, gy, gz = _back_into(here, n, gx, gy, gz)
        gz += here[_RATE * LANES + n]
        at = _PUSH_GROWTH * LANES + n
        out[at], out[at + LANES], out[at + 2 * LANES] = gx, gy, gz
        out[_PUSH * LANES + n], out[(_PUSH + 1) * LANES + n], out[(_PUSH + 2) * LANES + n] = ox, oy, oz
        x, y, z = _cross(gx, gy, gz, a, b, c)
        fx, fy, fz = mass * (ox + x), mass * (oy + y), mass * (oz + z)
        mx, my, mz = _cross(a, b, c, fx, fy, fz)
        here[_PUSHED * LANES + n], here[(_PUSHED + 1) * LANES + n], here[(_PUSHED + 2) * LANES + n] = fx, fy, fz
        at = (_PUSHED + _MOMENT) * LANES + n
        here[at] = xx * gx + xy * gy + xz * gz + mx
        here[at + LANES] = yx * gx + yy * gy + yz * gz + my
        here[at + 2 * LANES] = zx * gx + zy * gy + zz * gz + mz


@lent
def _swung(mass: float, com: Floats, inertia: Floats, offset: Floats, wide: int, here: Floats, out: Floats) -> None:
    """Forces on the link for its rotation and the change of that."""
    a, b, c, d, e, f = com[0], com[1], com[2], offset[0], offset[1], offset[2]
    xx, xy, xz, yx, yy, yz = inertia[0, 0], inertia[0, 1], inertia[0, 2], inertia[1, 0], inertia[1, 1], inertia[1, 2]
    zx, zy, zz = inertia[2, 0], inertia[2, 1], inertia[2, 2]
    for n in range(wide):
        wx, wy, wz = _three(out, _SPIN, n)
        gx, gy, gz = _three(out, _GROWTH, n)
        ox, oy, oz = _three(out, _ORIGIN, n)
        x, y, z = _cross(wx, wy, wz, d, e, f)
        x, y, z = _cross(wx, wy, wz, x, y, z)
        hx, hy, hz = _cross(gx, gy, gz, d, e, f)
        ox, oy, oz = _back_into(here, n, (x + hx) + ox, (y + hy) + oy, (z + hz) + oz)
        gx, gy, gz = _back_into(here, n, gx, gy, gz)
        wx, wy, wz = _back_into(here, n, wx, wy, wz)
        rate = here[_RATE * LANES + n]
        gx, gy, gz = gx + wy * rate, gy - wx * rate, gz + here[_CHANGE * LANES + n]
        wz += rate
        out[_SPIN * LANES + n], out[(_SPIN + 1) * LANES + n], out[(_SPIN + 2) * LANES + n] = wx, wy, wz
        out[_GROWTH * LANES + n], out[(_GROWTH + 1) * LANES + n], out[(_GROWTH + 2) * LANES + n] = gx, gy, gz
        out[_ORIGIN * LANES + n], out[(_ORIGIN + 1) * LANES + n], out[(_ORIGIN + 2) * LANES + n] = ox, oy, oz
        x, y, z = _cross(wx, wy, wz, a, b, c)
        x, y, z = _cross(wx, wy, wz, x, y, z)
        hx, hy, hz = _cross(gx, gy, gz, a, b, c)
        fx, fy, fz = mass * (ox + (x + hx)), mass * (oy + (y + hy)), mass * (oz + (z + hz))
        # What turns has a moment of momentum, which turns with it.
        hx, hy, hz = xx * wx + xy * wy + xz * wz, yx * wx + yy * wy + yz * wz, zx * wx + zy * wy + zz * wz
        x, y, z = _cross(wx, wy, wz, hx, hy, hz)
        mx, my, mz = _cross(a, b, c, fx, fy, fz)
        here[_SWUNG * LANES + n], here[(_SWUNG + 1) * LANES + n], here[(_SWUNG + 2) * LANES + n] = fx, fy, fz
        at = (_SWUNG + _MOMENT) * LANES + n
        here[at] = ((xx * gx + xy * gy + xz * gz) + x) + mx
        here[at + LANES] = ((yx * gx + yy * gy + yz * gz) + y) + my
        here[at + 2 * LANES] = ((zx * gx + zy * gy + zz * gz) + z) + mz


@lent
def _passed_on(offset: Floats, wide: int, here: Floats, before: Floats) -> None:
    """Adds the forces and moments that the joint passes on to the previous link."""
    d, e, f = offset[0], offset[1], offset[2]
    for run in range(_HELD, _ROWS, 2 * _MOMENT):
        force, moment = run * LANES, (run + _MOMENT) * LANES
        for n in range(wide):
            x, y, z = here[force + n], here[force + LANES + n], here[force + 2 * LANES + n]
            fx, fy, fz = _out_of(here, n, x, y, z)
            x, y, z = here[moment + n], here[moment + LANES + n], here[moment + 2 * LANES + n]
            mx, my, mz = _out_of(here, n, x, y, z)
            x, y, z = _cross(d, e, f, fx, fy, fz)
            before[force + n] += fx
            before[force + LANES + n] += fy
            before[force + 2 * LANES + n] += fz
            before[moment + n] += mx + x
            before[moment + LANES + n] += my + y
            before[moment + 2 * LANES + n] += mz + z


@compiled
def bears(
    masses: Masses, cosines: Floats, sines: Floats, step: int, dq: Floats, ddq: Floats
) -> tuple[Floats, Floats, Floats]:
    """Torques as of `torques`, at each `step`-th node of places with these cosines and sines, (6, nodes)."""
    rotations, offsets, coms, mass = masses.rotations, masses.offsets, masses.com, masses.mass
    inertia, lift, count = masses.inertia, masses.lift, dq.shape[0]
    hold, push, swing = np.empty((count, JOINTS)), np.empty((count, JOINTS)), np.empty((count, JOINTS))
    links, out = np.empty((JOINTS, _ROWS * LANES)), np.empty(_STATES * LANES)
    for first in range(0, count, LANES):
        wide = min(LANES, count - first)
        out[:] = 0.0
        for i in range(3):
            out[(_LIFT + i) * LANES : (_LIFT + i + 1) * LANES] = lift[i]
        for k in range(JOINTS):
            here, com, offset = links[k], coms[k], offsets[k]
            nodes = slice(first * step, (first + wide - 1) * step + 1, step)
            _turned(rotations[k], cosines[k, nodes], sines[k, nodes], wide, here)
            for n in range(wide):
                here[_RATE * LANES + n], here[_CHANGE * LANES + n] = dq[first + n, k], ddq[first + n, k]
            _held(mass[k], com, wide, here, out)
            _pushed(mass[k], com, inertia[k], offset, wide, here, out)
            _swung(mass[k], com, inertia[k], offset, wide, here, out)
        for k in range(JOINTS - 1, 0, -1):
            _passed_on(offsets[k], wide, links[k], links[k - 1])
        for k in range(JOINTS):
            for n in range(wide):
                hold[first + n, k] = links[k, (_HELD + _AXIS) * LANES + n]
                push[first + n, k] = links[k, (_PUSHED + _AXIS) * LANES + n]
                swing[first + n, k] = links[k, (_SWUNG + _AXIS) * LANES + n]
    return hold, push, swing


@entry
def torques(masses: Masses, q: Floats, dq: Floats, ddq: Floats) -> tuple[Floats, Floats, Floats]:
    """Torques along a path, each (n, 6), N m.

    They hold the arm, per unit of s'', and per s' squared.

    Args:
        masses: the links.
        q: configurations (n, 6), rad.
        dq, ddq: their first and second derivative by the path parameter, (n, 6).
    """
    cosines, sines = np.empty((JOINTS, q.shape[0])), np.empty((JOINTS, q.shape[0]))
    for k in range(JOINTS):
        for n in range(q.shape[0]):
            cosines[k, n], sines[k, n] = math.cos(q[n, k]), math.sin(q[n, k])
    return bears(masses, cosines, sines, 1, dq, ddq)

"""Torques of every joint at many configurations: the recursion of Newton and Euler, one configuration at a time.

Out along the arm go angular velocity w, its derivative, and the acceleration of each joint's origin; back come the
force and the moment that each link needs and passes on (Luh, Walker, Paul 1980). Torque is linear in gravity, in the
joints' accelerations and in what their rates alone do, so three runs are all that any timing of a path needs.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pep.pit.kernel.compiled import entry, lent

if TYPE_CHECKING:
    from pep.pit.motion import Floats

JOINTS = 6
HOLD, PUSH, SWING = range(3)


class Masses(NamedTuple):
    """The links as rigid bodies, each in the frame of the joint that carries it.

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
    """The links of a pinocchio model of six joints that each turn about their own z axis."""
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
def _cross(a: Floats, b: Floats, out: Floats) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@lent
def _back_into(turn: Floats, vector: Floats, out: Floats) -> None:
    """A vector of the frame before, in the turned one."""
    for i in range(3):
        out[i] = turn[0, i] * vector[0] + turn[1, i] * vector[1] + turn[2, i] * vector[2]


@lent
def _swung(asked: int, spin: Floats, growth: Floats, arm: Floats, one: Floats, two: Floats, out: Floats) -> None:
    """Acceleration that a point at `arm` has over the origin; `one` and `two` are room."""
    _cross(growth, arm, out)
    if asked == SWING:
        _cross(spin, arm, one)
        _cross(spin, one, two)
        for i in range(3):
            out[i] = two[i] + out[i]


@lent
def _moments(
    masses: Masses, turns: Floats, rate: Floats, change: Floats, lift: Floats, asked: int, room: Floats
) -> None:
    """Moments about each joint's axis stand in `room[5, :, 2]`.

    Args:
        masses: the links.
        turns: (6, 3, 3), each joint's frame in the one before.
        rate, change: (6,): of the joints, and its derivative.
        lift: (3,): acceleration of the base.
        asked: `HOLD` (all rates are 0 and stay so), `PUSH` (they are 0 and change) or `SWING`: nothing that is 0 is
            added.
        room: (7, 7, 3).
    """
    spin, growth, origin, force, own, moment = room[0], room[1], room[2], room[3], room[4], room[5]
    one, two, carried, here = room[6, 0], room[6, 1], room[6, 2], room[6, 3]
    offsets, coms, mass, inertia = masses.offsets, masses.com, masses.mass, masses.inertia
    for i in range(3):
        spin[0, i], growth[0, i], origin[0, i] = 0.0, 0.0, lift[i]
    for k in range(JOINTS):
        # Row k + 1 of spin, growth and origin is of joint k; row k of force and moment likewise.
        if asked == HOLD:
            _back_into(turns[k], origin[k], origin[k + 1])
            for i in range(3):
                force[k, i] = mass[k] * origin[k + 1, i]
            _cross(coms[k], force[k], own[k])
            continue
        _swung(asked, spin[k], growth[k], offsets[k], one, two, carried)
        for i in range(3):
            carried[i] += origin[k, i]
        _back_into(turns[k], carried, origin[k + 1])
        _back_into(turns[k], growth[k], growth[k + 1])
        growth[k + 1, 2] += change[k]
        if asked == SWING:
            _back_into(turns[k], spin[k], spin[k + 1])
            growth[k + 1, 0] += spin[k + 1, 1] * rate[k]
            growth[k + 1, 1] -= spin[k + 1, 0] * rate[k]
            spin[k + 1, 2] += rate[k]
        _swung(asked, spin[k + 1], growth[k + 1], coms[k], one, two, carried)
        for i in range(3):
            force[k, i] = mass[k] * (origin[k + 1, i] + carried[i])
            here[i] = carried[i] = 0.0
            for j in range(3):
                here[i] += inertia[k, i, j] * growth[k + 1, j]
        if asked == SWING:
            for i in range(3):
                for j in range(3):
                    carried[i] += inertia[k, i, j] * spin[k + 1, j]
            _cross(spin[k + 1], carried, one)
            for i in range(3):
                here[i] += one[i]
        _cross(coms[k], force[k], two)
        for i in range(3):
            own[k, i] = here[i] + two[i]
    for k in range(JOINTS - 1, -1, -1):
        for i in range(3):
            moment[k, i] = own[k, i]
        if k == JOINTS - 1:
            continue
        turn = turns[k + 1]
        for i in range(3):
            carried[i] = turn[i, 0] * force[k + 1, 0] + turn[i, 1] * force[k + 1, 1] + turn[i, 2] * force[k + 1, 2]
            here[i] = turn[i, 0] * moment[k + 1, 0] + turn[i, 1] * moment[k + 1, 1] + turn[i, 2] * moment[k + 1, 2]
        _cross(offsets[k + 1], carried, one)
        for i in range(3):
            force[k, i] += carried[i]
            moment[k, i] += here[i] + one[i]


@entry
def torques(masses: Masses, q: Floats, dq: Floats, ddq: Floats) -> tuple[Floats, Floats, Floats]:
    """Torques along a path, each (n, 6), N m: to hold the arm, per unit of s'', and per s' squared.

    Args:
        masses: the links.
        q: configurations (n, 6), rad.
        dq, ddq: their first and second derivative by the path parameter, (n, 6).
    """
    count = q.shape[0]
    hold, push, swing = np.empty((count, JOINTS)), np.empty((count, JOINTS)), np.empty((count, JOINTS))
    turns, room, still, rest = np.empty((JOINTS, 3, 3)), np.empty((7, 7, 3)), np.zeros(JOINTS), np.zeros(3)
    for n in range(count):
        for k in range(JOINTS):
            c, s = math.cos(q[n, k]), math.sin(q[n, k])
            for i in range(3):
                x, y = masses.rotations[k, i, 0], masses.rotations[k, i, 1]
                turns[k, i, 0], turns[k, i, 1], turns[k, i, 2] = x * c + y * s, y * c - x * s, masses.rotations[k, i, 2]
        _moments(masses, turns, still, still, masses.lift, HOLD, room)
        hold[n] = room[5, :JOINTS, 2]
        _moments(masses, turns, still, dq[n], rest, PUSH, room)
        push[n] = room[5, :JOINTS, 2]
        _moments(masses, turns, dq[n], ddq[n], rest, SWING, room)
        swing[n] = room[5, :JOINTS, 2]
    return hold, push, swing

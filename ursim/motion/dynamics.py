"""Joint torques of a motion: Newton and Euler's recursion over the links, in the base frame."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ursim.motion.spatial import Triple, add, cross, rotate, transpose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ursim.motion.arm import Arm, Body, Joints
    from ursim.motion.motion import Kinetic
    from ursim.motion.spatial import Frame

NOUGHT: Triple = (0.0, 0.0, 0.0)


def joint_torques(arm: Arm, frames: Sequence[Frame], now: Kinetic, load: Body, lift_m_s2: Triple) -> Joints:
    """Torques [Nm] that make the arm move as `now` says, without friction or contact.

    Args:
        arm: masses and inertias of its links.
        frames: its link frames at `now.q`.
        now: joint speeds and accelerations.
        load: the body that the tool carries, in the flange frame.
        lift_m_s2: the acceleration that holds against gravity, in the base frame: upwards on a floor.
    """
    spin, gain, rise, origin = NOUGHT, NOUGHT, lift_m_s2, NOUGHT
    wrenches: list[tuple[Triple, Triple]] = []  # of each link about the base's origin
    last = len(frames) - 1
    for j, (joint, (position, r)) in enumerate(zip(arm.joints, frames, strict=True)):
        step = _less(position, origin)
        rise = add(rise, _carried(spin, gain, step))
        axis = (r[2], r[5], r[8])
        turn = _times(axis, now.qd[j])
        gain = add(gain, add(_times(axis, now.qdd[j]), cross(spin, turn)))
        spin = add(spin, turn)
        origin = position
        motion = (spin, gain, rise)
        wrench = _wrench((position, r), joint.body, motion)
        if j == last and load.mass_kg > 0.0:
            held = _wrench((position, r), load, motion)
            wrench = (add(wrench[0], held[0]), add(wrench[1], held[1]))
        wrenches.append(wrench)
    force, moment = NOUGHT, NOUGHT
    torques: list[float] = []
    for (position, r), (own_force, own_moment) in zip(reversed(frames), reversed(wrenches), strict=True):
        force, moment = add(force, own_force), add(moment, own_moment)
        here = _less(moment, cross(position, force))
        torques.append(r[2] * here[0] + r[5] * here[1] + r[8] * here[2])
    return tuple(reversed(torques))


def acceleration(frames: Sequence[Frame], now: Kinetic, tcp: Frame) -> tuple[float, ...]:
    """Acceleration of the tool centre point in the base frame: m/s2, then rad/s2.

    Args:
        frames: the arm's link frames at `now.q`.
        now: joint speeds and accelerations.
        tcp: the tool centre point in the flange frame.
    """
    spin, gain, push, origin = NOUGHT, NOUGHT, NOUGHT, NOUGHT
    for (position, r), rate, growth in zip(frames, now.qd, now.qdd, strict=True):
        push = add(push, _carried(spin, gain, _less(position, origin)))
        axis = (r[2], r[5], r[8])
        turn = _times(axis, rate)
        gain = add(gain, add(_times(axis, growth), cross(spin, turn)))
        spin = add(spin, turn)
        origin = position
    return (*add(push, _carried(spin, gain, rotate(frames[-1][1], tcp[0]))), *gain)


def _carried(spin: Triple, gain: Triple, arm: Triple) -> Triple:
    """Acceleration that a body's turning adds at a point at `arm`."""
    return add(cross(gain, arm), cross(spin, cross(spin, arm)))


def linear_momentum(
    arm: Arm, frames: Sequence[Frame], qd: Sequence[float], payload_kg: float, payload_com_m: Triple
) -> float:
    """The norm [kg m/s] of the momentum of all links and the payload."""
    spin, speed, origin, total = NOUGHT, NOUGHT, NOUGHT, NOUGHT
    for joint, (position, r), rate in zip(arm.joints, frames, qd, strict=True):
        speed = add(speed, cross(spin, _less(position, origin)))
        spin = add(spin, _times((r[2], r[5], r[8]), rate))
        origin = position
        total = add(total, _times(add(speed, cross(spin, rotate(r, joint.body.com_m))), joint.body.mass_kg))
    last = rotate(frames[-1][1], payload_com_m)
    return math.hypot(*add(total, _times(add(speed, cross(spin, last)), payload_kg)))


def _wrench(frame: Frame, body: Body, motion: tuple[Triple, Triple, Triple]) -> tuple[Triple, Triple]:
    """Force, and moment about the base's origin, that move one body with its frame."""
    (position, r), (spin, gain, rise) = frame, motion
    arm = rotate(r, body.com_m)
    push = _times(add(rise, _carried(spin, gain, arm)), body.mass_kg)
    xx, yy, zz, xy, xz, yz = body.inertia_kg_m2
    back, inertia = transpose(r), (xx, xy, xz, xy, yy, yz, xz, yz, zz)
    flow = rotate(r, rotate(inertia, rotate(back, spin)))
    twist = add(rotate(r, rotate(inertia, rotate(back, gain))), cross(spin, flow))
    return push, add(twist, cross(add(position, arm), push))


def _less(a: Triple, b: Triple) -> Triple:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _times(a: Triple, factor: float) -> Triple:
    return (a[0] * factor, a[1] * factor, a[2] * factor)

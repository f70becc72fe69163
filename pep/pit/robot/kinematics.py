"""Places and speeds of all bodies along a path, in bulk, and bounds of their bending off a chord.

For a straight joint path q(s) = q0 + s dq the n-th derivative of a point carried by joint j is a sum over sequences of
n joints, each term at most the product of their |dq| times the lever of the outermost joint. With S_k the sum of |dq|
up to joint k this gives |p^(n)| <= sum_k reach_k (S_k^n - S_(k-1)^n): n = 2 bounds the bending, n = 3 the change of
speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Robot


@dataclass(frozen=True, slots=True)
class Poses:
    """Bodies at n configurations of one path, each body in the frame of its reference link.

    Attributes:
        ends: shape (n, bodies, 2, 3), metre: both ends of the axis.
        speed: shape (n, bodies), metre per unit of s: the faster end.
        spin: shape (n, bodies), radian per unit of s.
    """

    ends: Floats
    speed: Floats
    spin: Floats


@dataclass(frozen=True, slots=True)
class Layout:
    """The bodies of a robot as arrays.

    Attributes:
        link, reference: shape (bodies,).
        ends: shape (bodies, 2, 3), in the frame of `link`.
        radius: shape (bodies,).
        moved_by: shape (bodies, 6), 1 where the joint moves the body as seen from its reference link.
        seen_from_arm: indices of bodies whose reference link moves.
    """

    link: NDArray[np.intp]
    reference: NDArray[np.intp]
    ends: Floats
    radius: Floats
    moved_by: Floats
    seen_from_arm: NDArray[np.intp]


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def layout(robot: Robot) -> Layout:
    """The robot's bodies as arrays."""
    link = np.array([b.link for b in robot.bodies])
    reference = np.array([b.reference for b in robot.bodies])
    joint = np.arange(1, len(robot.model.joints) + 1)
    moved_by = ((joint > reference[:, None]) & (joint <= link[:, None])).astype(float)
    ends = np.array([(b.a_m, b.b_m) for b in robot.bodies])
    radius = np.array([b.radius_m for b in robot.bodies])
    return Layout(link, reference, ends, radius, moved_by, np.flatnonzero(reference > 0))


def link_frames(robot: Robot, q: Floats) -> tuple[Floats, Floats]:
    """Rotation (n, 7, 3, 3) and origin (n, 7, 3) of every link frame at `q` (n, 6).

    Link 0 is the base.
    """
    n, joints = q.shape
    rotation = np.empty((n, joints + 1, 3, 3))
    origin = np.empty((n, joints + 1, 3))
    rotation[:, 0] = np.eye(3)
    origin[:, 0] = 0
    cos, sin = np.cos(q), np.sin(q)
    for k in range(joints):
        origin[:, k + 1] = origin[:, k] + rotation[:, k] @ robot.offsets[k]
        turned = rotation[:, k] @ robot.rotations[k]
        c, s = cos[:, k, None], sin[:, k, None]
        rotation[:, k + 1, :, 0] = turned[:, :, 0] * c + turned[:, :, 1] * s
        rotation[:, k + 1, :, 1] = turned[:, :, 1] * c - turned[:, :, 0] * s
        rotation[:, k + 1, :, 2] = turned[:, :, 2]
    return rotation, origin


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross product along the last axis; numpy's own costs more than all the rest here."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def poses(robot: Robot, plan: Layout, q: Floats, dq: Floats) -> Poses:
    """All bodies at configurations `q` (n, 6) of a path with direction `dq` (6,)."""
    rotation, origin = link_frames(robot, q)
    ends = np.einsum("nbij,bej->nbei", rotation[:, plan.link], plan.ends, optimize=False) + origin[:, plan.link, None]
    # Turning about axis k through o_k: velocity of p is w_k x (p - o_k); summed, spin x p - sum w_k x o_k.
    turning = rotation[:, 1:, :, 2] * dq[None, :, None]
    spin = plan.moved_by @ turning
    carried = plan.moved_by @ _cross(turning, origin[:, 1:])
    velocity = _cross(spin[:, :, None], ends) - carried[:, :, None]
    speed = np.sqrt(np.einsum("nbei,nbei->nbe", velocity, velocity)).max(axis=2)
    seen = plan.seen_from_arm
    if seen.size:
        back = plan.reference[seen]
        ends[:, seen] = np.einsum("nbji,nbej->nbei", rotation[:, back], ends[:, seen] - origin[:, back, None])
    return Poses(ends, speed, np.sqrt(np.einsum("nbi,nbi->nb", spin, spin)))

"""Surface speeds of all bodies at once on intervals of a straight path.

Places are gone through side by side. Each result is to the last bit that of `arm.pose` and `arm.put`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.kernel.arithmetic.body_poses import LINKS, bends_of
from pep.pit.search.kernel.arithmetic.compilation import LANES, compiled, lent

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm, Bends

    Whole = NDArray[np.int64]


# Rows of a link, one number of each place: rotation and origin, three times four, then its turning and that's moment.
_TURN: Final = 12
_MOMENT: Final = 15
_LINK: Final = 18


@lent
def _carried(
    rotation: Floats, offset: Floats, rate: float, cosines: Floats, sines: Floats, wide: int, last: Floats, link: Floats
) -> None:
    """Motion of the link behind a joint, from the previous link, as of `arm.pose` but without second derivatives."""
    px, py, pz = offset[0], offset[1], offset[2]
    ra, rb, rc, sa, sb, sc = (
        rotation[0, 0],
        rotation[1, 0],
        rotation[2, 0],
        rotation[0, 1],
        rotation[1, 1],
        rotation[2, 1],
    )
    ta, tb, tc = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    for n in range(wide):
        c, sine = cosines[n], sines[n]
        ax, ay, az, ox = last[n], last[LANES + n], last[2 * LANES + n], last[3 * LANES + n]
        bx, by, bz, oy = last[4 * LANES + n], last[5 * LANES + n], last[6 * LANES + n], last[7 * LANES + n]
        cx, cy, cz, oz = last[8 * LANES + n], last[9 * LANES + n], last[10 * LANES + n], last[11 * LANES + n]
        ox, oy, oz = (
            ox + ax * px + ay * py + az * pz,
            oy + bx * px + by * py + bz * pz,
            oz + cx * px + cy * py + cz * pz,
        )
        fa, fb, fc = ax * ra + ay * rb + az * rc, bx * ra + by * rb + bz * rc, cx * ra + cy * rb + cz * rc
        ga, gb, gc = ax * sa + ay * sb + az * sc, bx * sa + by * sb + bz * sc, cx * sa + cy * sb + cz * sc
        az, bz, cz = ax * ta + ay * tb + az * tc, bx * ta + by * tb + bz * tc, cx * ta + cy * tb + cz * tc
        link[n], link[LANES + n] = fa * c + ga * sine, ga * c - fa * sine
        link[2 * LANES + n], link[3 * LANES + n] = az, ox
        link[4 * LANES + n], link[5 * LANES + n] = fb * c + gb * sine, gb * c - fb * sine
        link[6 * LANES + n], link[7 * LANES + n] = bz, oy
        link[8 * LANES + n], link[9 * LANES + n] = fc * c + gc * sine, gc * c - fc * sine
        link[10 * LANES + n], link[11 * LANES + n] = cz, oz
        wx, wy, wz = az * rate, bz * rate, cz * rate
        at = _TURN * LANES + n
        link[at] = last[at] + wx
        link[at + LANES] = last[at + LANES] + wy
        link[at + 2 * LANES] = last[at + 2 * LANES] + wz
        at = _MOMENT * LANES + n
        link[at] = last[at] + wy * oz - wz * oy
        link[at + LANES] = last[at + LANES] + wz * ox - wx * oz
        link[at + 2 * LANES] = last[at + 2 * LANES] + wx * oy - wy * ox


@lent
def _turning(wide: int, link: Floats, spin: Floats) -> None:
    for n in range(wide):
        at = _TURN * LANES + n
        x, y, z = link[at], link[at + LANES], link[at + 2 * LANES]
        spin[n] = math.sqrt(x * x + y * y + z * z)


@lent
def _faster(end: Floats, wide: int, link: Floats, square: Floats) -> None:
    """Raises the squares to at least those of the speed of this end of a body on the link."""
    px, py, pz = end[0], end[1], end[2]
    for n in range(wide):
        x = link[3 * LANES + n] + link[n] * px + link[LANES + n] * py + link[2 * LANES + n] * pz
        y = link[7 * LANES + n] + link[4 * LANES + n] * px + link[5 * LANES + n] * py + link[6 * LANES + n] * pz
        z = link[11 * LANES + n] + link[8 * LANES + n] * px + link[9 * LANES + n] * py + link[10 * LANES + n] * pz
        turn, moment = _TURN * LANES + n, _MOMENT * LANES + n
        sx, sy, sz = link[turn], link[turn + LANES], link[turn + 2 * LANES]
        vx = sy * z - sz * y - link[moment]
        vy = sz * x - sx * z - link[moment + LANES]
        vz = sx * y - sy * x - link[moment + 2 * LANES]
        square[n] = max(square[n], vx * vx + vy * vy + vz * vz)


@lent
def _roots(wide: int, square: Floats) -> None:
    for n in range(wide):
        square[n] = math.sqrt(square[n])


@compiled
def speeds_at(arm: Arm, delta: Floats, cosines: Floats, sines: Floats) -> tuple[Floats, Floats]:
    """Speed of every body that is seen from the base, (bodies, nodes), and turning of every link, (links, nodes).

    Both per unit of ds/dt; nothing stands there of other bodies.

    Args:
        arm: arm with these bodies.
        delta: way of the joints, rad.
        cosines, sines: of the joints' angles at each node, (joints, nodes).
    """
    links, references, own, rotations, offsets = arm.link, arm.reference, arm.ends, arm.rotations, arm.offsets
    count = cosines.shape[1]
    speed, spin, room = np.empty((links.shape[0], count)), np.zeros((LINKS, count)), np.zeros((LINKS, _LINK * LANES))
    for i in range(3):
        room[0, 5 * i * LANES : (5 * i + 1) * LANES] = 1.0  # the diagonal of the base's rotation: each fifth of twelve
    for first in range(0, count, LANES):
        wide = min(LANES, count - first)
        nodes = slice(first, first + wide)
        for k in range(LINKS - 1):
            last, link = room[k], room[k + 1]
            _carried(rotations[k], offsets[k], delta[k], cosines[k, nodes], sines[k, nodes], wide, last, link)
            _turning(wide, link, spin[k + 1, nodes])
        for body in range(links.shape[0]):
            if references[body] > 0:
                continue
            link, square = room[links[body]], speed[body, nodes]
            square[:] = 0.0
            for end in range(2):
                _faster(own[body, end], wide, link, square)
            _roots(wide, square)
    return speed, spin


@lent
def _rush(
    arm: Arm, bends: Bends, low: Whole, high: Whole, first: Whole, speed: Floats, spin: Floats, rush: Floats
) -> None:
    """Bound on every body's surface speed per unit of ds/dt on each interval, whose nodes begin with `first`.

    Of bodies that are seen from the arm itself it is the rough one: nobody asks how fast the arm passes itself.
    """
    links, references, radius = arm.link, arm.reference, arm.radius
    most, third, spin_most, spin_second = bends.first, bends.third, bends.spin, bends.spin_second
    for n in range(low.shape[0]):
        width, a, b, c = (high[n] - low[n]) / GRID, first[n], first[n] + 1, first[n] + 2
        bend = width * width / CHORD
        for body in range(links.shape[0]):
            if references[body] > 0:
                fast, turning = most[body], spin_most[body]
            else:
                k = links[body]
                fast = max(speed[body, a], speed[body, b], speed[body, c])
                turning = max(spin[k, a], spin[k, b], spin[k, c])
            fast += third[body] * bend
            rush[n, body] = fast + radius[body] * (turning + spin_second[body] * bend)


@compiled
def rush_on(arm: Arm, asked: Floats, low: Whole, high: Whole, rush: Floats) -> tuple[Floats, Floats]:
    """Bound on every body's surface speed per unit of ds/dt on these intervals, written to `rush`, (n, bodies).

    Args:
        arm: arm with these bodies.
        asked: start and way of the joints, side by side, rad.
        low, high: the intervals, in 1 / GRID; one that follows the one before shares a node with it.
        rush: written.

    Returns:
        Cosines and sines of the joints' angles at the nodes, (joints, nodes): of each interval its start, its middle
        and its end.
    """
    joints = arm.offsets.shape[0]
    start, delta = asked[:joints], asked[joints:]
    keys, first, used = np.empty(3 * low.shape[0], np.int64), np.empty(low.shape[0], np.int64), 0
    for n in range(low.shape[0]):
        if n > 0 and low[n] == high[n - 1]:
            used -= 1
        keys[used], keys[used + 1], keys[used + 2] = low[n], (low[n] + high[n]) // 2, high[n]
        first[n], used = used, used + 3
    cosines, sines = np.empty((joints, used)), np.empty((joints, used))
    for n in range(used):
        s = keys[n] / GRID
        for k in range(joints):
            angle = start[k] + s * delta[k]
            cosines[k, n], sines[k, n] = math.cos(angle), math.sin(angle)
    speed, spin = speeds_at(arm, delta, cosines, sines)
    _rush(arm, bends_of(arm, delta), low, high, first, speed, spin, rush)
    return cosines, sines

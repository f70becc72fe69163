"""How fast the surfaces of all bodies go on intervals of a straight path, for who asks for all bodies at once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.kernel.arm import LINKS, arm_in, bends_of
from pep.pit.kernel.compiled import compiled, entry, lent
from pep.pit.path import CHORD, GRID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Arm, Bends
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]


# Columns of a link: rotation and origin, three rows of four, then its turning and that's moment (`arm.Nodes`).
_TURN: Final = 12
_MOMENT: Final = 15
_LINK: Final = 18


@lent
def _carried(arm: Arm, q: Floats, delta: Floats, links: Floats) -> None:
    """Of every link at `q` what `arm.pose` says of it, but for second derivatives, in `links`, (links, `_LINK`)."""
    rotations, offsets = arm.rotations, arm.offsets
    links[0] = 0.0
    links[0, 0] = links[0, 5] = links[0, 10] = 1.0  # the diagonal of the rotation
    ax, ay, az, bx, by, bz, cx, cy, cz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    ox = oy = oz = sx = sy = sz = mx = my = mz = 0.0
    for k in range(LINKS - 1):
        c, sine, rate = math.cos(q[k]), math.sin(q[k]), delta[k]
        x, y, z = offsets[k, 0], offsets[k, 1], offsets[k, 2]
        ox, oy, oz = ox + ax * x + ay * y + az * z, oy + bx * x + by * y + bz * z, oz + cx * x + cy * y + cz * z
        x, y, z = rotations[k, 0, 0], rotations[k, 1, 0], rotations[k, 2, 0]
        fa, fb, fc = ax * x + ay * y + az * z, bx * x + by * y + bz * z, cx * x + cy * y + cz * z
        x, y, z = rotations[k, 0, 1], rotations[k, 1, 1], rotations[k, 2, 1]
        ga, gb, gc = ax * x + ay * y + az * z, bx * x + by * y + bz * z, cx * x + cy * y + cz * z
        x, y, z = rotations[k, 0, 2], rotations[k, 1, 2], rotations[k, 2, 2]
        az, bz, cz = ax * x + ay * y + az * z, bx * x + by * y + bz * z, cx * x + cy * y + cz * z
        ax, ay = fa * c + ga * sine, ga * c - fa * sine
        bx, by = fb * c + gb * sine, gb * c - fb * sine
        cx, cy = fc * c + gc * sine, gc * c - fc * sine
        wx, wy, wz = az * rate, bz * rate, cz * rate
        sx, sy, sz = sx + wx, sy + wy, sz + wz
        mx, my, mz = mx + wy * oz - wz * oy, my + wz * ox - wx * oz, mz + wx * oy - wy * ox
        row = links[k + 1]
        row[0], row[1], row[2], row[3] = ax, ay, az, ox
        row[4], row[5], row[6], row[7] = bx, by, bz, oy
        row[8], row[9], row[10], row[11] = cx, cy, cz, oz
        row[_TURN], row[_TURN + 1], row[_TURN + 2] = sx, sy, sz
        row[_MOMENT], row[_MOMENT + 1], row[_MOMENT + 2] = mx, my, mz


@lent
def _at(
    arm: Arm,
    start: Floats,
    delta: Floats,
    key: int,
    q: Floats,
    links: Floats,
    bodies: Whole,
    speed: Floats,
    spin: Floats,
) -> None:
    """Speed of these bodies, seen from the base, and turning of every link at `key`, per unit of ds/dt.

    Args:
        arm, start, delta, key: where.
        q, links: room for a configuration.
        bodies: row 0 which, row 1 how many ends of each: a point has one.
        speed, spin: (bodies,) and (links,), written.
    """
    for joint in range(q.shape[0]):
        q[joint] = start[joint] + key / GRID * delta[joint]
    _carried(arm, q, delta, links)
    link, own = arm.link, arm.ends
    for k in range(LINKS):
        x, y, z = links[k, _TURN], links[k, _TURN + 1], links[k, _TURN + 2]
        spin[k] = math.sqrt(x * x + y * y + z * z)
    for n in range(bodies.shape[1]):
        body, fastest = bodies[0, n], 0.0
        k = link[body]
        fa, fb, fc, fd = links[k, 0], links[k, 1], links[k, 2], links[k, 3]
        ga, gb, gc, gd = links[k, 4], links[k, 5], links[k, 6], links[k, 7]
        ha, hb, hc, hd = links[k, 8], links[k, 9], links[k, 10], links[k, 11]
        sx, sy, sz = links[k, _TURN], links[k, _TURN + 1], links[k, _TURN + 2]
        cx, cy, cz = links[k, _MOMENT], links[k, _MOMENT + 1], links[k, _MOMENT + 2]
        for end in range(bodies[1, n]):
            ax, ay, az = own[body, end, 0], own[body, end, 1], own[body, end, 2]
            x = fd + fa * ax + fb * ay + fc * az
            y = gd + ga * ax + gb * ay + gc * az
            z = hd + ha * ax + hb * ay + hc * az
            vx, vy, vz = sy * z - sz * y - cx, sz * x - sx * z - cy, sx * y - sy * x - cz
            fastest = max(fastest, vx * vx + vy * vy + vz * vz)
        speed[body] = math.sqrt(fastest)


@compiled
def _seen_from_the_base(arm: Arm) -> Whole:
    """Those bodies, and how many different ends each has, (2, n)."""
    own, which = arm.ends, np.flatnonzero(arm.reference == 0)
    found = np.empty((2, which.shape[0]), np.int64)
    for n in range(which.shape[0]):
        body = which[n]
        apart = False
        for axis in range(3):
            apart |= own[body, 0, axis] != own[body, 1, axis]
        found[0, n], found[1, n] = body, 2 if apart else 1  # ends
    return found


@lent
def _rush(arm: Arm, bends: Bends, width: float, speed: Floats, spin: Floats, out: Floats) -> None:
    """Bound on every body's surface speed per unit of ds/dt on the interval of these three nodes.

    Of bodies that are seen from the arm itself it is the rough one: nobody asks how fast the arm passes itself.
    """
    links, references, radius = arm.link, arm.reference, arm.radius
    first, third, spin_most, spin_second = bends.first, bends.third, bends.spin, bends.spin_second
    bend = width * width / CHORD
    for body in range(links.shape[0]):
        if references[body] > 0:
            fast, turning = first[body], spin_most[body]
        else:
            k = links[body]
            fast = max(speed[0, body], speed[1, body], speed[2, body])
            turning = max(spin[0, k], spin[1, k], spin[2, k])
        fast += third[body] * bend
        out[body] = fast + radius[body] * (turning + spin_second[body] * bend)


@entry
def rush_on(arm_numbers: Floats, arm_whole: Whole, asked: Floats, low: Whole, high: Whole, rush: Floats) -> None:
    """Bound on every body's surface speed per unit of ds/dt on these intervals, written to `rush`, (n, bodies).

    Args:
        arm_numbers, arm_whole: the arm (`arm.blocks_of`).
        asked: start and way of the joints, side by side, rad.
        low, high: the intervals, in 1 / GRID; one that follows the one before shares a node with it.
        rush: written.
    """
    arm = arm_in(arm_numbers, arm_whole)
    joints, bodies = arm.offsets.shape[0], arm.link.shape[0]
    start, delta, q = asked[:joints], asked[joints:], np.empty(joints)
    bends, links, seen = bends_of(arm, delta), np.empty((LINKS, _LINK)), _seen_from_the_base(arm)
    speed, spin = np.empty((3, bodies)), np.empty((3, LINKS))
    for n in range(low.shape[0]):
        if n > 0 and low[n] == high[n - 1]:
            speed[0], spin[0] = speed[2], spin[2]
        else:
            _at(arm, start, delta, low[n], q, links, seen, speed[0], spin[0])
        _at(arm, start, delta, (low[n] + high[n]) // 2, q, links, seen, speed[1], spin[1])
        _at(arm, start, delta, high[n], q, links, seen, speed[2], spin[2])
        _rush(arm, bends, (high[n] - low[n]) / GRID, speed, spin, rush[n])

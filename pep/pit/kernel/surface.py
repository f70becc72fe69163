"""How fast the surfaces of all bodies go on intervals of a straight path, for who asks for all bodies at once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.kernel.arm import LINKS, arm_in, bends_of, no_nodes, pose
from pep.pit.kernel.compiled import entry, lent
from pep.pit.path import CHORD, GRID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Arm, Bends, Nodes
    from pep.pit.motion import Floats

    Whole = NDArray[np.int64]


@lent
def _at(arm: Arm, start: Floats, delta: Floats, key: int, q: Floats, nodes: Nodes, speed: Floats, spin: Floats) -> None:
    """Speed of every body that is seen from the base and turning of every link at `key`, per unit of ds/dt.

    Args:
        arm, start, delta, key: where.
        q, nodes: room for a configuration.
        speed, spin: (bodies,) and (links,), written.
    """
    for joint in range(q.shape[0]):
        q[joint] = start[joint] + key / GRID * delta[joint]
    pose(nodes, 0, arm, q, delta)
    frames, turning, links, references, own = nodes.frames, nodes.turning, arm.link, arm.reference, arm.ends
    for k in range(LINKS):
        x, y, z = turning[0, k, 0, 0], turning[0, k, 0, 1], turning[0, k, 0, 2]
        spin[k] = math.sqrt(x * x + y * y + z * z)
    for body in range(links.shape[0]):
        if references[body] > 0:
            continue
        k, fastest = links[body], 0.0
        sx, sy, sz = turning[0, k, 0, 0], turning[0, k, 0, 1], turning[0, k, 0, 2]
        cx, cy, cz = turning[0, k, 1, 0], turning[0, k, 1, 1], turning[0, k, 1, 2]
        for end in range(2):
            ax, ay, az = own[body, end, 0], own[body, end, 1], own[body, end, 2]
            x = frames[0, k, 0, 3] + frames[0, k, 0, 0] * ax + frames[0, k, 0, 1] * ay + frames[0, k, 0, 2] * az
            y = frames[0, k, 1, 3] + frames[0, k, 1, 0] * ax + frames[0, k, 1, 1] * ay + frames[0, k, 1, 2] * az
            z = frames[0, k, 2, 3] + frames[0, k, 2, 0] * ax + frames[0, k, 2, 1] * ay + frames[0, k, 2, 2] * az
            vx, vy, vz = sy * z - sz * y - cx, sz * x - sx * z - cy, sx * y - sy * x - cz
            fastest = max(fastest, vx * vx + vy * vy + vz * vz)
        speed[body] = math.sqrt(fastest)


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
    bends, nodes, speed, spin = bends_of(arm, delta), no_nodes(1, bodies), np.empty((3, bodies)), np.empty((3, LINKS))
    for n in range(low.shape[0]):
        if n > 0 and low[n] == high[n - 1]:
            speed[0], spin[0] = speed[2], spin[2]
        else:
            _at(arm, start, delta, low[n], q, nodes, speed[0], spin[0])
        _at(arm, start, delta, (low[n] + high[n]) // 2, q, nodes, speed[1], spin[1])
        _at(arm, start, delta, high[n], q, nodes, speed[2], spin[2])
        _rush(arm, bends, (high[n] - low[n]) / GRID, speed, spin, rush[n])

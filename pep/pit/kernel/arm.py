"""Where the links and bodies are and how fast they go, one configuration at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.kernel.compiled import compiled, entry, lent, merged

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Whole = NDArray[np.int64]

LINKS: Final = 7  # of a six-joint arm, the base included


class Arm(NamedTuple):
    """A robot's bodies and joints.

    Attributes:
        link, reference: shape (bodies,): which link carries the body, and from which it is seen.
        ends: shape (bodies, 2, 3), metre, in the frame of the link.
        radius: shape (bodies,), metre.
        half: shape (bodies,), half the axis' length, metre.
        reach: shape (bodies, 6), metre: distance of the ends from each joint's axis at most.
        rotations, offsets: shape (6, 3, 3) and (6, 3): joint frames at angle 0.
    """

    link: Whole
    reference: Whole
    ends: Floats
    radius: Floats
    half: Floats
    reach: Floats
    rotations: Floats
    offsets: Floats


class Bends(NamedTuple):
    """Per body, over the whole path: bounds on its ends' first, second and third derivative, on its spin and that's."""

    first: Floats
    second: Floats
    third: Floats
    spin: Floats
    spin_first: Floats
    spin_second: Floats


class Nodes(NamedTuple):
    """Configurations of one path, and the bodies that were placed there so far.

    Attributes:
        frames: shape (n, 7, 3, 4): rotation and origin of every link.
        turning: shape (n, 7, 2, 3): sums over the joints up to the link of w_k, and of w_k x o_k.
        ends: shape (n, bodies, 2, 3); speed, spin: shape (n, bodies), per unit of s.
        known: shape (n, bodies), whether the body was placed.
    """

    frames: Floats
    turning: Floats
    ends: Floats
    speed: Floats
    spin: Floats
    known: Any


@compiled
def no_nodes(count: int, bodies: int) -> Nodes:
    """Room for so many configurations."""
    return Nodes(
        np.empty((count, LINKS, 3, 4)),
        np.empty((count, LINKS, 2, 3)),
        np.empty((count, bodies, 2, 3)),
        np.empty((count, bodies)),
        np.empty((count, bodies)),
        np.zeros((count, bodies), np.bool_),
    )


@compiled
def more_nodes(nodes: Nodes) -> Nodes:
    """The same configurations with twice the room."""
    count, bodies = nodes.speed.shape
    wide = no_nodes(2 * count, bodies)
    wide.frames[:count] = nodes.frames
    wide.turning[:count] = nodes.turning
    wide.ends[:count] = nodes.ends
    wide.speed[:count] = nodes.speed
    wide.spin[:count] = nodes.spin
    wide.known[:count] = nodes.known
    return wide


@entry
def bends_of(arm: Arm, delta: Floats) -> Bends:
    """How strongly each body can move and leave a chord of the path (derivation: `pep.pit.kinematics`)."""
    links, references, reaches = arm.link, arm.reference, arm.reach
    bodies = links.shape[0]
    first, second, third = np.zeros(bodies), np.zeros(bodies), np.zeros(bodies)
    spin, spin_first, spin_second = np.zeros(bodies), np.zeros(bodies), np.zeros(bodies)
    for body in range(bodies):
        inner = 0.0
        for joint in range(references[body], links[body]):
            share = abs(delta[joint])
            outer = inner + share
            reach = reaches[body, joint]
            first[body] += reach * share
            second[body] += reach * (outer**2 - inner**2)
            third[body] += reach * (outer**3 - inner**3)  # third power: third derivative
            spin[body] += share
            spin_first[body] += share * inner
            spin_second[body] += share * inner**2
            inner = outer
    return Bends(first, second, third, spin, spin_first, spin_second)


@lent
def pose(nodes: Nodes, at: int, arm: Arm, q: Floats, delta: Floats) -> None:
    """The link frames at `q` stand in row `at`; no body is placed there yet."""
    frames, turning, known = nodes.frames, nodes.turning, nodes.known
    rotations, offsets = arm.rotations, arm.offsets
    for body in range(known.shape[1]):
        known[at, body] = False
    for i in range(3):
        for j in range(4):
            frames[at, 0, i, j] = 1.0 if i == j else 0.0
        turning[at, 0, 0, i] = 0.0
        turning[at, 0, 1, i] = 0.0
    # The last link's frame and turning as plain numbers: out of the arrays they would be read again at each step.
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
        to = k + 1
        frames[at, to, 0, 0], frames[at, to, 0, 1], frames[at, to, 0, 2], frames[at, to, 0, 3] = ax, ay, az, ox
        frames[at, to, 1, 0], frames[at, to, 1, 1], frames[at, to, 1, 2], frames[at, to, 1, 3] = bx, by, bz, oy
        frames[at, to, 2, 0], frames[at, to, 2, 1], frames[at, to, 2, 2], frames[at, to, 2, 3] = cx, cy, cz, oz
        wx, wy, wz = az * rate, bz * rate, cz * rate
        sx, sy, sz = sx + wx, sy + wy, sz + wz
        mx, my, mz = mx + wy * oz - wz * oy, my + wz * ox - wx * oz, mz + wx * oy - wy * ox
        turning[at, to, 0, 0], turning[at, to, 0, 1], turning[at, to, 0, 2] = sx, sy, sz
        turning[at, to, 1, 0], turning[at, to, 1, 1], turning[at, to, 1, 2] = mx, my, mz


@lent
def place(nodes: Nodes, at: int, arm: Arm, body: int) -> None:
    """The body stands in row `at`, in its reference link's frame, with its speed and spin."""
    if not nodes.known[at, body]:
        put(
            nodes.frames, nodes.turning, nodes.ends, nodes.speed, nodes.spin, nodes.known,
            arm.link, arm.reference, arm.ends, at, body,
        )  # fmt: skip


@lent
def place_all(nodes: Nodes, at: int, arm: Arm, bodies: Whole) -> None:
    """All these bodies stand there."""
    frames, turning, ends, speed = nodes.frames, nodes.turning, nodes.ends, nodes.speed
    spin, known, link, reference, own = nodes.spin, nodes.known, arm.link, arm.reference, arm.ends
    for each in range(bodies.shape[0]):
        if not known[at, bodies[each]]:
            put(frames, turning, ends, speed, spin, known, link, reference, own, at, bodies[each])


@merged
def put(
    frames: Floats,
    turning: Floats,
    ends: Floats,
    speed: Floats,
    spin: Floats,
    known: Any,
    link: Whole,
    reference: Whole,
    own: Floats,
    at: int,
    body: int,
) -> None:
    """The same for who has the arrays at hand; the body is not there yet."""
    known[at, body] = True
    k, r = link[body], reference[body]
    sx, sy, sz = (
        turning[at, k, 0, 0] - turning[at, r, 0, 0],
        turning[at, k, 0, 1] - turning[at, r, 0, 1],
        turning[at, k, 0, 2] - turning[at, r, 0, 2],
    )
    cx, cy, cz = (
        turning[at, k, 1, 0] - turning[at, r, 1, 0],
        turning[at, k, 1, 1] - turning[at, r, 1, 1],
        turning[at, k, 1, 2] - turning[at, r, 1, 2],
    )
    fastest = 0.0
    for end in range(2):
        ax, ay, az = own[body, end, 0], own[body, end, 1], own[body, end, 2]
        x = frames[at, k, 0, 3] + frames[at, k, 0, 0] * ax + frames[at, k, 0, 1] * ay + frames[at, k, 0, 2] * az
        y = frames[at, k, 1, 3] + frames[at, k, 1, 0] * ax + frames[at, k, 1, 1] * ay + frames[at, k, 1, 2] * az
        z = frames[at, k, 2, 3] + frames[at, k, 2, 0] * ax + frames[at, k, 2, 1] * ay + frames[at, k, 2, 2] * az
        vx, vy, vz = sy * z - sz * y - cx, sz * x - sx * z - cy, sx * y - sy * x - cz
        fastest = max(fastest, vx * vx + vy * vy + vz * vz)
        if r > 0:
            ux, uy, uz = x - frames[at, r, 0, 3], y - frames[at, r, 1, 3], z - frames[at, r, 2, 3]
            x = frames[at, r, 0, 0] * ux + frames[at, r, 1, 0] * uy + frames[at, r, 2, 0] * uz
            y = frames[at, r, 0, 1] * ux + frames[at, r, 1, 1] * uy + frames[at, r, 2, 1] * uz
            z = frames[at, r, 0, 2] * ux + frames[at, r, 1, 2] * uy + frames[at, r, 2, 2] * uz
        ends[at, body, end, 0], ends[at, body, end, 1], ends[at, body, end, 2] = x, y, z
    speed[at, body] = math.sqrt(fastest)
    spin[at, body] = math.sqrt(sx * sx + sy * sy + sz * sz)

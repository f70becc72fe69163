"""Places and speeds of links and bodies, one configuration at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.search.kernel.arithmetic.compilation import compiled, entry, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into

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


def blocks_of(arm: Arm) -> tuple[Floats, Whole]:
    """Numbers of the arm, and its whole numbers, each as one array.

    A call from Python pays for each array that it hands over.
    """
    return np.concatenate([np.ravel(part) for part in arm[2:]]), np.concatenate(arm[:2])


@compiled
def arm_in(numbers: Floats, whole: Whole) -> Arm:
    """Arm that these blocks describe."""
    bodies, joints = whole.shape[0] // 2, LINKS - 1
    ends, at = numbers[: 6 * bodies].reshape((bodies, 2, 3)), 6 * bodies
    radius, at = numbers[at : at + bodies], at + bodies
    half, at = numbers[at : at + bodies], at + bodies
    reach, at = numbers[at : at + bodies * joints].reshape((bodies, joints)), at + bodies * joints
    rotations, at = numbers[at : at + 9 * joints].reshape((joints, 3, 3)), at + 9 * joints
    offsets = numbers[at : at + 3 * joints].reshape((joints, 3))
    return Arm(whole[:bodies], whole[bodies:], ends, radius, half, reach, rotations, offsets)


class Bends(NamedTuple):
    """Bounds of each body over the whole path.

    First three derivatives of its ends; its spin, and the first two derivatives of that.
    """

    first: Floats
    second: Floats
    third: Floats
    spin: Floats
    spin_first: Floats
    spin_second: Floats


class Nodes(NamedTuple):
    """Configurations of one path, and the bodies placed there so far.

    Attributes:
        frames: shape (n, 7, 3, 4): rotation and origin of every link.
        turning: shape (n, 7, 4, 3): sums over the joints up to the link of w_k, and of w_k x o_k, then their
            derivatives by s while all joints keep their rates.
        ends: shape (n, bodies, 2, 3).
        speed, swerve, spin: shape (n, bodies), of the faster end its first derivative by s, of the one that swerves
            more its second while all joints keep their rates, and the body's turning.
        known: shape (n, bodies), whether the body was placed.
    """

    frames: Floats
    turning: Floats
    ends: Floats
    speed: Floats
    swerve: Floats
    spin: Floats
    known: Any


@compiled
def no_nodes(count: int, bodies: int) -> Nodes:
    """Room for so many configurations."""
    return Nodes(
        np.empty((count, LINKS, 3, 4)),
        np.empty((count, LINKS, 4, 3)),
        np.empty((count, bodies, 2, 3)),
        np.empty((count, bodies)),
        np.empty((count, bodies)),
        np.empty((count, bodies)),
        np.zeros((count, bodies), np.bool_),
    )


@compiled
def more_nodes(nodes: Nodes) -> Nodes:
    """The same configurations with twice the room."""
    count, bodies = nodes.speed.shape
    wide = no_nodes(2 * count, bodies)
    copy_into(wide.frames, nodes.frames)
    copy_into(wide.turning, nodes.turning)
    copy_into(wide.ends, nodes.ends)
    copy_into(wide.speed, nodes.speed)
    copy_into(wide.swerve, nodes.swerve)
    copy_into(wide.spin, nodes.spin)
    copy_into(wide.known, nodes.known)
    return wide


@entry
def bends_of(arm: Arm, delta: Floats) -> Bends:
    """Bounds on each body's motion and its bend off a chord of the path (derivation: `pep.pit.robot.kinematics`)."""
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
    """Writes the link frames at `q` to row `at`; no body is placed there yet."""
    frames, turning, known = nodes.frames, nodes.turning, nodes.known
    rotations, offsets = arm.rotations, arm.offsets
    for body in range(known.shape[1]):
        known[at, body] = False
    for i in range(3):
        for j in range(4):
            frames[at, 0, i, j] = 1.0 if i == j else 0.0
        for j in range(4):
            turning[at, 0, j, i] = 0.0
    # The last link's frame and turning as plain numbers: out of the arrays they would be read again at each step.
    ax, ay, az, bx, by, bz, cx, cy, cz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    ox = oy = oz = sx = sy = sz = mx = my = mz = dx = dy = dz = ex = ey = ez = 0.0
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
        # The links before turn this joint's axis and carry its origin.
        tx, ty, tz = sy * wz - sz * wy, sz * wx - sx * wz, sx * wy - sy * wx
        ux, uy, uz = sy * oz - sz * oy - mx, sz * ox - sx * oz - my, sx * oy - sy * ox - mz
        dx, dy, dz = dx + tx, dy + ty, dz + tz
        ex += ty * oz - tz * oy + wy * uz - wz * uy
        ey += tz * ox - tx * oz + wz * ux - wx * uz
        ez += tx * oy - ty * ox + wx * uy - wy * ux
        sx, sy, sz = sx + wx, sy + wy, sz + wz
        mx, my, mz = mx + wy * oz - wz * oy, my + wz * ox - wx * oz, mz + wx * oy - wy * ox
        turning[at, to, 0, 0], turning[at, to, 0, 1], turning[at, to, 0, 2] = sx, sy, sz
        turning[at, to, 1, 0], turning[at, to, 1, 1], turning[at, to, 1, 2] = mx, my, mz
        turning[at, to, 2, 0], turning[at, to, 2, 1], turning[at, to, 2, 2] = dx, dy, dz
        turning[at, to, 3, 0], turning[at, to, 3, 1], turning[at, to, 3, 2] = ex, ey, ez


@lent
def place(nodes: Nodes, at: int, arm: Arm, body: int) -> None:
    """Places the body in row `at`, in its reference link's frame, with its speed and spin."""
    if not nodes.known[at, body]:
        put(
            nodes.frames, nodes.turning, nodes.ends, nodes.speed, nodes.swerve, nodes.spin, nodes.known,
            arm.link, arm.reference, arm.ends, at, body,
        )  # fmt: skip


@lent
def place_all(nodes: Nodes, at: int, arm: Arm, bodies: Whole) -> None:
    """Places all these bodies there."""
    frames, turning, ends, speed, swerve = nodes.frames, nodes.turning, nodes.ends, nodes.speed, nodes.swerve
    spin, known, link, reference, own = nodes.spin, nodes.known, arm.link, arm.reference, arm.ends
    for each in range(bodies.shape[0]):
        if not known[at, bodies[each]]:
            put(frames, turning, ends, speed, swerve, spin, known, link, reference, own, at, bodies[each])


@lent
def squares(
    x: float,
    y: float,
    z: float,
    rx: float,
    ry: float,
    rz: float,
    mx: float,
    my: float,
    mz: float,
    sx: float,
    sy: float,
    sz: float,
    cx: float,
    cy: float,
    cz: float,
    dx: float,
    dy: float,
    dz: float,
    ex: float,
    ey: float,
    ez: float,
) -> tuple[float, float]:
    """Squares of the first two derivatives by s of a body's point, as its reference link sees it.

    Args:
        x, y, z: the point, seen from the base.
        rx, ry, rz, mx, my, mz: the reference link's turning and its moment.
        sx, sy, sz, cx, cy, cz, dx, dy, dz, ex, ey, ez: the body's own beyond those, and both their derivatives.
    """
    vx, vy, vz = sy * z - sz * y - cx, sz * x - sx * z - cy, sx * y - sy * x - cz
    # Seen from the base the point moves faster by how it moves with the reference link, which turns what is seen.
    ux, uy, uz = vx + ry * z - rz * y - mx, vy + rz * x - rx * z - my, vz + rx * y - ry * x - mz
    bx = dy * z - dz * y + sy * uz - sz * uy - ex - (ry * vz - rz * vy)
    by = dz * x - dx * z + sz * ux - sx * uz - ey - (rz * vx - rx * vz)
    bz = dx * y - dy * x + sx * uy - sy * ux - ez - (rx * vy - ry * vx)
    return vx * vx + vy * vy + vz * vz, bx * bx + by * by + bz * bz


@lent
def put(
    frames: Floats,
    turning: Floats,
    ends: Floats,
    speed: Floats,
    swerve: Floats,
    spin: Floats,
    known: Any,
    link: Whole,
    reference: Whole,
    own: Floats,
    at: int,
    body: int,
) -> None:
    """Places a body as `place` does, for a caller with the arrays at hand; it is not there yet."""
    known[at, body] = True
    k, r = link[body], reference[body]
    # Of the reference link, then of the body's own beyond that: turning, its moment, and both their derivatives.
    rx, ry, rz = turning[at, r, 0, 0], turning[at, r, 0, 1], turning[at, r, 0, 2]
    sx, sy, sz = turning[at, k, 0, 0] - rx, turning[at, k, 0, 1] - ry, turning[at, k, 0, 2] - rz
    mx, my, mz = turning[at, r, 1, 0], turning[at, r, 1, 1], turning[at, r, 1, 2]
    cx, cy, cz = turning[at, k, 1, 0] - mx, turning[at, k, 1, 1] - my, turning[at, k, 1, 2] - mz
    dx, dy, dz = (
        turning[at, k, 2, 0] - turning[at, r, 2, 0],
        turning[at, k, 2, 1] - turning[at, r, 2, 1],
        turning[at, k, 2, 2] - turning[at, r, 2, 2],
    )
    ex, ey, ez = (
        turning[at, k, 3, 0] - turning[at, r, 3, 0],
        turning[at, k, 3, 1] - turning[at, r, 3, 1],
        turning[at, k, 3, 2] - turning[at, r, 3, 2],
    )
    fastest = most = 0.0
    for end in range(2):
        ax, ay, az = own[body, end, 0], own[body, end, 1], own[body, end, 2]
        x = frames[at, k, 0, 3] + frames[at, k, 0, 0] * ax + frames[at, k, 0, 1] * ay + frames[at, k, 0, 2] * az
        y = frames[at, k, 1, 3] + frames[at, k, 1, 0] * ax + frames[at, k, 1, 1] * ay + frames[at, k, 1, 2] * az
        z = frames[at, k, 2, 3] + frames[at, k, 2, 0] * ax + frames[at, k, 2, 1] * ay + frames[at, k, 2, 2] * az
        first, second = squares(x, y, z, rx, ry, rz, mx, my, mz, sx, sy, sz, cx, cy, cz, dx, dy, dz, ex, ey, ez)
        fastest, most = max(fastest, first), max(most, second)
        if r > 0:
            ux, uy, uz = x - frames[at, r, 0, 3], y - frames[at, r, 1, 3], z - frames[at, r, 2, 3]
            x = frames[at, r, 0, 0] * ux + frames[at, r, 1, 0] * uy + frames[at, r, 2, 0] * uz
            y = frames[at, r, 0, 1] * ux + frames[at, r, 1, 1] * uy + frames[at, r, 2, 1] * uz
            z = frames[at, r, 0, 2] * ux + frames[at, r, 1, 2] * uy + frames[at, r, 2, 2] * uz
        ends[at, body, end, 0], ends[at, body, end, 1], ends[at, body, end, 2] = x, y, z
    speed[at, body], swerve[at, body] = math.sqrt(fastest), math.sqrt(most)
    spin[at, body] = math.sqrt(sx * sx + sy * sy + sz * sz)

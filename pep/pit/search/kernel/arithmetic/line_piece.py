"""One piece of a line of the tool: proven bounds on the joints' path (proof: `pep.pit.path.line_trace`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pep.pit.path.line_trace import BEND_OF_LOG, GROWTH, ROOM, ROOM_ABOVE, ROUND_UP, ROUNDS
from pep.pit.robot.inverse_kinematics import EXACT
from pep.pit.search.kernel.arithmetic.compilation import compiled
from pep.pit.search.kernel.arithmetic.tool_pose import JOINTS

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats


class PieceBounds(NamedTuple):
    """Values of a piece: derivatives in its middle, and their bounds on the whole of it, each (6,).

    Attributes:
        dq, ddq: in the middle, rad per power of s.
        first, second, third: bounds of the derivatives.
        gain: (6, 2): growth of a linear and an angular deviation in each joint.
        mixed: (6, 6): |G J'|.
        room: (4, 6).
    """

    dq: Floats
    ddq: Floats
    first: Floats
    second: Floats
    third: Floats
    gain: Floats
    mixed: Floats
    room: Floats


@compiled
def no_bounds() -> PieceBounds:
    """Room for the bounds of a piece, still empty."""
    return PieceBounds(
        np.empty(JOINTS),
        np.empty(JOINTS),
        np.empty(JOINTS),
        np.empty(JOINTS),
        np.empty(JOINTS),
        np.empty((JOINTS, 2)),
        np.empty((JOINTS, JOINTS)),
        np.empty((4, JOINTS)),
    )


@compiled
def gain_of(inverse: Floats, gain: Floats) -> None:
    """Writes to `gain` (6, 2) the growth of a linear and an angular deviation in each joint."""
    for i in range(JOINTS):
        x, y, z = inverse[i, 0], inverse[i, 1], inverse[i, 2]
        a, b, c = inverse[i, 3], inverse[i, 4], inverse[i, 5]
        gain[i, 0], gain[i, 1] = math.sqrt(x * x + y * y + z * z), math.sqrt(a * a + b * b + c * c)


@compiled
def lever_first(reach: Floats, w: Floats, v: Floats) -> tuple[float, float]:
    """Bound of |sum_k J_k' v_k|, linear and angular, for joint rates of at most w."""
    s = t = linear = angular = 0.0
    for k in range(JOINTS):
        before, until = s, t
        s, t = s + w[k], t + v[k]
        linear += reach[k] * (s * t - before * until)
        angular += v[k] * before
    return linear, angular


@compiled
def lever_second(reach: Floats, w: Floats, a: Floats, v: Floats) -> tuple[float, float]:
    """Bound of |sum_k J_k'' v_k|, for rates of at most w that change by at most a."""
    linear, angular = lever_first(reach, a, v)
    s = t = 0.0
    for k in range(JOINTS):
        before, until = s, t
        s, t = s + w[k], t + v[k]
        linear += reach[k] * (s * s * t - before * before * until)
        angular += v[k] * before * before
    return linear, angular


@compiled
def _off(reach: Floats, w: Floats, gain: Floats, mixed: Floats, r: float, a: Floats, x: Floats, out: Floats) -> None:
    """Writes to `out` a bound of |G (J - J(m))| x within `r`.

    It holds for |q'| <= `w` and |q''| <= `a`.
    """
    linear, angular = lever_second(reach, w, a, x)
    for i in range(JOINTS):
        straight = 0.0
        for j in range(JOINTS):
            straight += mixed[i, j] * x[j]
        out[i] = r * straight + 0.5 * r * r * (gain[i, 0] * linear + gain[i, 1] * angular)


@compiled
def _follows(
    reach: Floats,
    dq: Floats,
    ddq: Floats,
    gain: Floats,
    mixed: Floats,
    r: float,
    a: Floats,
    w: Floats,
    need: Floats,
) -> None:
    """Writes to `need` the bound of |q''| that follows from the bound `a`, and to `w` that of |q'|."""
    for i in range(JOINTS):
        w[i] = abs(dq[i]) + r * a[i]
    linear, angular = lever_second(reach, w, a, w)
    more, turned = lever_first(reach, w, a)
    linear, angular = linear + more, angular + turned
    _off(reach, w, gain, mixed, r, a, a, need)
    for i in range(JOINTS):
        change = r * (gain[i, 0] * linear + gain[i, 1] * angular)
        need[i] = (abs(ddq[i]) + change + need[i]) * ROUND_UP


@compiled
def prove_derivatives(reach: Floats, bounds: PieceBounds, r: float, fastest: float, hardest: float) -> bool:
    """Bounds the first three derivatives within `r` of the middle; False where nothing is proven.

    Args:
        reach: of the tool point about each joint's axis, (6,), m.
        bounds: holds what is known of the middle.
        r: half the width of the piece.
        fastest, hardest: the largest of |q'| and |q''| there.
    """
    dq, ddq, gain, mixed, w = bounds.dq, bounds.ddq, bounds.gain, bounds.mixed, bounds.first
    a, need, constant, b = bounds.second, bounds.room[0], bounds.room[1], bounds.third
    most = GROWTH * (hardest + fastest)
    for i in range(JOINTS):
        a[i] = abs(ddq[i]) + ROOM * (hardest + fastest)
    closed = False
    for _ in range(ROUNDS):
        _follows(reach, dq, ddq, gain, mixed, r, a, w, need)
        closed = True
        for i in range(JOINTS):
            closed = closed and need[i] < a[i]
        if closed:
            break
        for i in range(JOINTS):
            wider = need[i] * (1 + ROOM * ROOM)
            if not wider <= a[i]:
                a[i] = wider
            if not a[i] <= most:
                return False
    if not closed:
        return False
    for _ in range(3):  # the consequence of a bound is a bound: bring it down
        _follows(reach, dq, ddq, gain, mixed, r, a, w, need)
        for i in range(JOINTS):
            a[i] = min(a[i], need[i])
    for i in range(JOINTS):
        w[i] = (abs(dq[i]) + r * a[i]) * ROUND_UP
    # J q''' = -J'' q' - 2 J' q'', and the same inverse; each round adds less than the one before.
    linear, angular = lever_second(reach, w, a, w)
    more, turned = lever_first(reach, w, a)
    linear, angular = linear + 2 * more, angular + 2 * turned
    for i in range(JOINTS):
        constant[i] = gain[i, 0] * linear + gain[i, 1] * angular
        b[i] = constant[i]
    for _ in range(ROUNDS):
        _off(reach, w, gain, mixed, r, a, b, need)
        closed = True
        for i in range(JOINTS):
            need[i] += constant[i]
            closed = closed and need[i] <= b[i] * ROUND_UP
        if closed:
            for i in range(JOINTS):
                b[i] *= 1 + ROOM_ABOVE
            return True
        for i in range(JOINTS):
            b[i] = need[i]
    return False


@compiled
def on_path(
    reach: Floats, q: Floats, inverse: Floats, near: Floats, within: Floats, gain: Floats, room: Floats
) -> bool:
    """True where `q` (6,) is the only configuration near `near` with its tool's pose.

    It is within `within` of it; all are (6,).

    Two of them differ by at most twice that, joint by joint; on so small a box Newton's map from `q` contracts.

    Args:
        reach: of the tool point about each joint's axis, (6,), m.
        q: the configuration.
        inverse: of its Jacobian, (6, 6).
        near: its expected place.
        within: allowed distance from it.
        gain: room, (6, 2).
        room: likewise, (2, 6).
    """
    wide, one = room[0], room[1]
    angle = 0.0
    for i in range(JOINTS):
        if not abs(q[i] - near[i]) <= within[i] + EXACT:
            return False
        wide[i], one[i] = 2 * (within[i] + EXACT), 1.0
        angle += wide[i]
    if not angle <= 1:
        return False
    gain_of(inverse, gain)
    linear, angular = lever_first(reach, wide, one)
    angular += BEND_OF_LOG * angle * JOINTS
    closer = True
    for i in range(JOINTS):
        closer = closer and gain[i, 0] * linear + gain[i, 1] * angular < 1
    return closer

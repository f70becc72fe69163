"""Course and its configurations, each computed once.

Keys find them in a small table with open addresses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np

from pep.pit.path.straight_path import GRID
from pep.pit.search.kernel.arithmetic.bending import DDQ, DQ, Q, first_at_least
from pep.pit.search.kernel.arithmetic.body_poses import more_nodes, no_nodes, pose
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.tool_pose import JOINTS, divided, no_stand, solved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm, Nodes
    from pep.pit.search.kernel.arithmetic.tool_pose import KernelTwist, Stand, Wrist

    Whole = NDArray[np.int64]

PLACES: Final = 256  # in the table at first, a power of two
SPREAD: Final = 0x9E3779B1  # 2^32 by the golden ratio: neighbouring keys land far apart (Knuth, TAOCP 3, 6.4)
FREE: Final = -1
USED: Final = 0  # of the counts: configurations
LOST: Final = 1  # of the counts: those that Newton's method did not find again


class KernelTrack(NamedTuple):
    """Track as `pep.pit.path.course_angles.Track`; `until` is below 0 where there is no line."""

    line: KernelTwist
    until: float
    q: Floats
    dq: Floats


class Curve(NamedTuple):
    """A course of one arm.

    Attributes:
        arm, wrist: the robot.
        low, high: of the cells, (cells,), in 1 / GRID.
        cells: bounds of the joints there, (cells, HELD, 6).
        bends: bounds of the bodies, (cells, BENDS, bodies).
        track: exact joint angles.
    """

    arm: Arm
    wrist: Wrist
    low: Whole
    high: Whole
    cells: Floats
    bends: Floats
    track: KernelTrack


class CurveConfigurations(NamedTuple):
    """Configurations computed so far: the row of each key. At most half of the places are used.

    Attributes:
        nodes: link frames and bodies.
        q: joint angles, (n, 6); keys: of the rows, (n,).
        key, row: the table.
        counts: `USED` and `LOST`.
        stand, room: for Newton's method.
    """

    nodes: Nodes
    q: Floats
    keys: Whole
    key: Whole
    row: Whole
    counts: Whole
    stand: Stand
    room: Floats


def nothing_known(bodies: int) -> CurveConfigurations:
    """No configuration."""
    half, nodes, stand = PLACES // 2, cast("Any", no_nodes), cast("Any", no_stand)
    return CurveConfigurations(
        nodes.py_func(half, bodies), np.empty((half, JOINTS)), np.empty(half, np.int64), np.full(PLACES, FREE),
        np.full(PLACES, FREE), np.zeros(2, np.int64), stand.py_func(), np.empty((11, JOINTS)),
    )  # fmt: skip


@compiled
def _place_of(table: Whole, key: int) -> int:
    """Place of the key in the table, taken or free."""
    at = ((key >> 2) * SPREAD >> 8) & (table.shape[0] - 1)
    while table[at] != FREE and table[at] != key:
        at = (at + 1) & (table.shape[0] - 1)
    return at


@compiled
def with_room(known: CurveConfigurations, count: int) -> CurveConfigurations:
    """The same with room for at least so many more configurations."""
    used = known.counts[USED]
    if 2 * (used + count) < known.key.shape[0]:
        return known
    size, nodes = known.key.shape[0], known.nodes
    while 2 * (used + count) >= size:
        size *= 2
    while nodes.speed.shape[0] < size // 2:
        nodes = more_nodes(nodes)
    key, row = np.full(size, FREE), np.full(size, FREE)
    q, keys = np.empty((size // 2, JOINTS)), np.empty(size // 2, np.int64)
    copy_into(q, known.q)
    copy_into(keys, known.keys)
    for each in range(used):
        at = _place_of(key, keys[each])
        key[at], row[at] = keys[each], each
    return CurveConfigurations(nodes, q, keys, key, row, known.counts, known.stand, known.room)


@compiled
def _go_to(curve: Curve, key: float, known: CurveConfigurations, q: Floats, dq: Floats) -> None:
    """Writes the joint angles at `key` to `q` and their derivative by s to `dq`, (6,).

    Both are NaN where the angles are lost.
    """
    track, s = curve.track, key / GRID
    if not s <= track.until:
        on = s - max(track.until, 0.0)
        for i in range(JOINTS):
            q[i], dq[i] = track.q[i] + on * track.dq[i], track.dq[i]
        return
    cell = min(first_at_least(curve.high, key), curve.high.shape[0] - 1)
    mid = (curve.low[cell] + curve.high[cell]) // 2
    cells, stand = curve.cells, known.stand
    if key == mid:  # the trace found them
        for i in range(JOINTS):
            q[i], dq[i] = cells[cell, Q, i], cells[cell, DQ, i]
        return
    off = (key - mid) / GRID
    for i in range(JOINTS):
        stand.q[i] = cells[cell, Q, i] + off * (cells[cell, DQ, i] + 0.5 * off * cells[cell, DDQ, i])
    found = solved(curve.wrist, track.line, s, stand, known.room)
    for i in range(3):
        dq[i], dq[3 + i] = track.line.line[i], track.line.turn[i]
    if not (found and divided(stand.jacobian, dq)):
        known.counts[LOST] += 1
        stand.q[:] = np.nan
        dq[:] = np.nan
    copy_into(q, stand.q)


@compiled
def row_of(known: CurveConfigurations, key: int, curve: Curve) -> int:
    """Row of the configuration at `key`, computed where it is new; there is room for it."""
    at = _place_of(known.key, key)
    if known.key[at] == key:
        return known.row[at]
    row = known.counts[USED]
    known.key[at], known.row[at], known.keys[row] = key, row, key
    known.counts[USED] = row + 1
    dq = known.room[10]
    _go_to(curve, key, known, known.q[row], dq)
    pose(known.nodes, row, curve.arm, known.q[row], dq)
    return row


@compiled
def rows_of(known: CurveConfigurations, low: int, high: int, curve: Curve) -> tuple[int, int, int]:
    """Rows of the configurations at both ends and in the middle; there is room for them."""
    return row_of(known, low, curve), row_of(known, (low + high) // 2, curve), row_of(known, high, curve)


@entry
def placed(known: CurveConfigurations, curve: Curve, s: float, q: Floats, dq: Floats) -> None:
    """Writes to `q` and `dq`, (6,), the joint angles at any `s` and their derivative; keeps no row."""
    _go_to(curve, s * GRID, known, q, dq)

"""Bends of each body off a chord of a course, or the course, per cell and per interval.

Laws: `pep.pit.path.course`.

One row per cell and quantity; the columns of quantities are named here once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.geometry.clearance import ROUNDING_M
from pep.pit.path.straight_path import CHORD
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm

    Whole = NDArray[np.int64]

# Bounds on derivatives of a body's ends (m) and of its spin (rad), per power of s, and on its stray from the course.
FIRST: Final = 0
SECOND: Final = 1
THIRD: Final = 2
SPIN: Final = 3
SPIN_FIRST: Final = 4
SPIN_SECOND: Final = 5
STRAY: Final = 6
HURRY: Final = 7
SPIN_HURRY: Final = 8
BENDS: Final = 9

# Rows of a cell's bounds of the joints, in the order of `pep.pit.path.course.Cells`.
Q: Final = 0
DQ: Final = 1
DDQ: Final = 2
ONE: Final = 3
TWO: Final = 4
THREE: Final = 5
STRAYS: Final = 6
HURRIES: Final = 7
HELD: Final = 8


@entry
def bends_of(arm: Arm, cells: Floats) -> Floats:
    """Bounds per cell, quantity and body, (cells, BENDS, bodies), from bounds of the joints, (cells, HELD, 6)."""
    link, reference, reach = arm.link, arm.reference, arm.reach
    bends = np.zeros((cells.shape[0], BENDS, link.shape[0]))
    for cell in range(cells.shape[0]):
        for body in range(link.shape[0]):
            s = sa = sd = 0.0
            for joint in range(reference[body], link[body]):
                w, a, b = cells[cell, ONE, joint], cells[cell, TWO, joint], cells[cell, THREE, joint]
                d, e = cells[cell, STRAYS, joint], cells[cell, HURRIES, joint]
                lever = reach[body, joint]
                so, sao, sdo = s + w, sa + a, sd + d
                bends[cell, FIRST, body] += lever * w
                bends[cell, SECOND, body] += lever * (a + so * so - s * s)
                cubes = so * so * so - s * s * s  # third power: third derivative
                bends[cell, THIRD, body] += lever * (b + 3 * (so * sao - s * sa) + cubes)
                bends[cell, SPIN, body] += w
                bends[cell, SPIN_FIRST, body] += a + w * s
                bends[cell, SPIN_SECOND, body] += b + 2 * a * s + w * (s * s + sa)
                bends[cell, STRAY, body] += lever * d
                bends[cell, HURRY, body] += lever * (e + so * sdo - s * sd)
                bends[cell, SPIN_HURRY, body] += e + w * sd
                s, sa, sd = so, sao, sdo
    return bends


@compiled
def first_at_least(values: Whole, key: float) -> int:
    """Number of the rising values that are below `key`."""
    low, high = 0, values.shape[0]
    while low < high:
        mid = (low + high) // 2
        if values[mid] < key:
            low = mid + 1
        else:
            high = mid
    return low


@compiled
def worst_on(bends: Floats, cell_low: Whole, cell_high: Whole, low: int, high: int, room: Floats) -> Floats:
    """The worst bounds of the cells that the interval meets, (BENDS, bodies); `room` has that shape."""
    first, last = first_at_least(cell_high, low + 1), first_at_least(cell_low, high)
    if last - first == 1:
        return bends[first]
    bodies = bends.shape[2]
    for quantity in range(BENDS):
        for body in range(bodies):
            room[quantity, body] = bends[first, quantity, body]
    for cell in range(first + 1, last):
        for quantity in range(BENDS):
            for body in range(bodies):
                room[quantity, body] = max(room[quantity, body], bends[cell, quantity, body])
    return room


@compiled
def sag_on(worst: Floats, body: int, width: float) -> float:
    """Distance of the body's axis from the chord between neighbours of three nodes, at most, metre.

    The stray is added.
    """
    return worst[SECOND, body] * width * width / CHORD + worst[STRAY, body]


@compiled
def _rises(worst: Floats, body: int, width: float) -> tuple[float, float]:
    """Excess of speed and spin over those of the nodes, at most, without the hurry.

    Between nodes by the chord lemma, or by the next node, which is at most a quarter away: whichever proves more.
    """
    bend = width * width / CHORD
    rise = min(worst[THIRD, body] * bend, worst[SECOND, body] * width / 4)
    return rise, min(worst[SPIN_SECOND, body] * bend, worst[SPIN_FIRST, body] * width / 4)


@compiled
def rush_on(worst: Floats, body: int, width: float, speed: float, spin: float, radius: float) -> float:
    """Bound on the body's surface speed per unit of ds/dt, from the speed and spin at its nodes."""
    rise, spin_rise = _rises(worst, body, width)
    return speed + rise + worst[HURRY, body] + radius * (spin + spin_rise + worst[SPIN_HURRY, body])


@compiled
def rough_rush(worst: Floats, body: int, width: float, radius: float) -> float:
    """Bound on `rush_on` that needs no configuration."""
    return rush_on(worst, body, width, worst[FIRST, body], worst[SPIN, body], radius)


@compiled
def rough_stray(worst: Floats, body: int, width: float) -> float:
    """Distance of any part of the body's axis from its place in the interval's middle, at most, metre.

    Its levers bound the way in half the interval. The sag is added, so that no clearance found from this is above what
    `interval_gap` proves.
    """
    return 0.5 * worst[FIRST, body] * width + sag_on(worst, body, width) + 2.0 * ROUNDING_M

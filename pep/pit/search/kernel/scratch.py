"""Memory of a search, kept from one to the next, since fresh memory costs more than the search.

It is three blocks, for all contents: for each array that is handed over, Python counts references and numba reads the
shape, and that costs as much as ten rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import LAW, PROFILE
from pep.pit.search.kernel.arithmetic.body_poses import LINKS, Nodes
from pep.pit.search.kernel.arithmetic.compilation import compiled
from pep.pit.search.kernel.arithmetic.heap import Heap
from pep.pit.search.kernel.interval_tree import RATES, SPAN, Tree
from pep.pit.search.kernel.search_columns import ROW_NUMBERS, ROW_WHOLE, STAGES_IN_DOUBT, STOP, SearchRows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats

NODES_FIRST: Final = 512  # room for configurations at first; hardly a question needs more, which costs more than it
ASKED: Final = (
    2 * (LINKS - 1) + PROFILE + LAW + STOP
)  # start and target, timing, law, and the numbers for a slower speed
COUNTERS: Final = 5  # of rows, doubts, the heap, nodes and spans
_FRAME: Final = 12  # 3 x 4
_TURNING: Final = 12  # 4 x 3
_PLACED: Final = 9  # both ends, 2 x 3, speed, swerve and spin


class Room(NamedTuple):
    """Memory for so many rows; the rest follows from the number of bodies and joints.

    What is asked stands first in `numbers`: `ASKED` of them.
    """

    numbers: Floats
    whole: NDArray[np.int64]
    flags: Any
    rows: int


def room_for(bodies: int, joints: int, rows: int) -> Room:
    """Room for so many rows of an arm with so many bodies and joints."""
    node = LINKS * (_FRAME + _TURNING) + _PLACED * bodies
    return Room(
        np.empty(ASKED + rows * (ROW_NUMBERS + 1) + NODES_FIRST * (RATES + node) + joints),
        np.empty(COUNTERS + rows * (ROW_WHOLE + STAGES_IN_DOUBT + 1) + NODES_FIRST * (SPAN + 1), np.int64),
        np.empty(NODES_FIRST * (bodies + 1), np.bool_),
        rows,
    )


@compiled
def laid_out(room: Room, bodies: int, joints: int) -> tuple[Tree, SearchRows, Heap]:
    """Empty tree, no rows and an empty heap in this room, which fits this arm."""
    count, rows, numbers, whole, flags = NODES_FIRST, room.rows, room.numbers, room.whole, room.flags
    whole[:COUNTERS] = 0
    at = COUNTERS
    row_whole, at = whole[at : at + ROW_WHOLE * rows].reshape((rows, ROW_WHOLE)), at + ROW_WHOLE * rows
    doubts, at = whole[at : at + STAGES_IN_DOUBT * rows], at + STAGES_IN_DOUBT * rows
    heap_row, at = whole[at : at + rows], at + rows
    key, at = whole[at : at + count], at + count
    spans = whole[at : at + SPAN * count].reshape((count, SPAN))
    row_numbers, at = (
        numbers[ASKED : ASKED + ROW_NUMBERS * rows].reshape((rows, ROW_NUMBERS)),
        ASKED + ROW_NUMBERS * rows,
    )
    heap_key, at = numbers[at : at + rows], at + rows
    q, at = numbers[at : at + joints], at + joints
    rates, at = numbers[at : at + RATES * count].reshape((count, RATES)), at + RATES * count
    wide = _FRAME * LINKS * count
    frames, at = numbers[at : at + wide].reshape((count, LINKS, 3, 4)), at + wide
    wide = _TURNING * LINKS * count
    turning, at = numbers[at : at + wide].reshape((count, LINKS, 4, 3)), at + wide
    wide = bodies * count
    ends, at = numbers[at : at + 6 * wide].reshape((count, bodies, 2, 3)), at + 6 * wide
    speed, at = numbers[at : at + wide].reshape((count, bodies)), at + wide
    swerve, at = numbers[at : at + wide].reshape((count, bodies)), at + wide
    spin = numbers[at : at + wide].reshape((count, bodies))
    known, posed = flags[:wide].reshape((count, bodies)), flags[wide : wide + count]
    nodes = Nodes(frames, turning, ends, speed, swerve, spin, known)
    return (
        Tree(nodes, key, posed, spans, rates, whole[3:5], q),
        SearchRows(row_whole, row_numbers, doubts, whole[0:2]),
        Heap(heap_key, heap_row, whole[2:3]),
    )

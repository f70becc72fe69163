"""Distances of pairs at one place of a straight path, for a single question: nothing is kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.pair_columns import BODY, RADII, SHAPE
from pep.pit.path.straight_path import GRID
from pep.pit.search.kernel.arithmetic.body_poses import arm_in, no_nodes, place, pose
from pep.pit.search.kernel.arithmetic.compilation import entry
from pep.pit.search.kernel.arithmetic.core_distance import core_gap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats

    Whole = NDArray[np.int64]


@entry
def clearances(
    arm_numbers: Floats,
    arm_whole: Whole,
    pair_numbers: Floats,
    pair_whole: Whole,
    asked: Floats,
    key: int,
    pairs: Whole,
) -> Floats:
    """Signed clearance of these pairs, metre. Few arrays and no tuples of them, as of `straight.certify`.

    Args:
        arm_numbers, arm_whole: the arm (`arm.blocks_of`).
        pair_numbers, pair_whole: all pairs (`rows.Field`).
        asked: start and way of the joints, side by side, rad.
        key: the place, in 1 / GRID.
        pairs: pairs in question.
    """
    arm = arm_in(arm_numbers, arm_whole)
    joints = arm.offsets.shape[0]
    delta, q = asked[joints:], np.empty(joints)
    for joint in range(joints):
        q[joint] = asked[joint] + key / GRID * delta[joint]
    nodes, found = no_nodes(1, arm.link.shape[0]), np.empty(pairs.shape[0])
    pose(nodes, 0, arm, q, delta)
    ends, placed = nodes.ends, nodes.known
    for row in range(pairs.shape[0]):
        pair = pairs[row]
        body = pair_whole[pair, BODY]
        if not placed[0, body]:
            place(nodes, 0, arm, body)
        gap = core_gap(ends, 0, body, pair_numbers, pair, pair_whole[pair, SHAPE])[0]
        found[row] = gap - pair_numbers[pair, RADII]
    return found

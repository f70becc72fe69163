"""Proof that a declared and granted contact is gentle; only then it counts as meant.

Gentle means, wherever on the way the body may be near the object: no faster than the cell's contact speed, and pressed
no deeper than the error of fingers and arm. It is proven like the index, interval by interval; a pair without that
proof keeps the ordinary law on the whole way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.errors import WorkLimitError
from pep.pit.path.straight_path import GRID
from pep.pit.search.certify import DEPTH, ROWS_MOST, first_cut

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile
    from pep.pit.path.path import Route
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs


def gentle_rows(
    path: Route,
    pairs: Pairs,
    profile: Profile,
    cell: CellParameters,
    *,
    since: int = 0,
    check_time: Callable[[], None],
) -> NDArray[np.intp]:
    """Touchable pairs whose contact is proven gentle on the path from `since` (in 1 / GRID) to its end.

    Raises:
        WorkLimitError: more rows than `ROWS_MOST` were needed.
    """
    rows = np.flatnonzero(pairs.touchable)
    if not rows.size or since >= GRID:
        return rows

    def gentle(clearance: Floats, speed: Floats) -> NDArray[np.bool_]:
        apart = clearance >= cell.contact_near_m
        slow = speed <= cell.contact_speed_m_s
        return np.asarray(apart | (slow & (clearance >= -cell.contact_depth_m)))

    rough = np.zeros(len(pairs), dtype=bool)
    leaves = first_cut(path, pairs, rows, since=since)
    examined = 0
    for depth in range(DEPTH + 1):
        check_time()
        examined += len(leaves)
        if examined > ROWS_MOST:
            raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
        mid = leaves.mid
        met = ~gentle(leaves.clear_mid_m, leaves.rush_mid * profile.rate(mid / GRID)) & (mid >= since)
        rough[leaves.pair[met]] = True
        rate = profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
        unproven = ~gentle(leaves.clear_m, leaves.rush * rate) & ~rough[leaves.pair]
        if not unproven.any():
            break
        if depth == DEPTH:
            rough[leaves.pair[unproven]] = True
            break
        leaves = path.halve(pairs, leaves.take(unproven), since=since)
    return rows[~rough[rows]]

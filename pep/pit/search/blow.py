"""The worst blow that a motion could deal: speed by the limit speed of a body region, where a blow is possible at all.

Possible means: the region, seen where it was seen, is within the protective separation distance of that link in that
interval of the path. Proven like the index, by branch and bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import Kind
from pep.pit.search.certify import first_cut

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Route
    from pep.pit.scene.pairs import Pairs

DEPTH: Final = 7  # halvings; what is still open then counts with its bound
RESOLUTION: Final = 0.01  # PHY-4: ratio within which bound and attained value may differ


def blow_ratio(path: Route, pairs: Pairs, profile: Profile, stop: Stopping, *, check_time: Callable[[], None]) -> float:
    """Proven: no body region that the arm could meet on this path is met at more than this share of its limit speed."""
    rows = np.flatnonzero(pairs.kind == pairs.code_of(Kind.PERSON))
    if not rows.size:
        return 0.0
    leaves = first_cut(path, pairs, rows)
    proven = best = 0.0
    for depth in range(DEPTH + 1):
        check_time()
        mid = leaves.mid / GRID
        attained = _ratio(pairs, leaves.pair, leaves.clear_mid_m, leaves.rush_mid * profile.rate(mid), stop)
        rate = profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
        bound = _ratio(pairs, leaves.pair, leaves.clear_m, leaves.rush * rate, stop)
        best = max(best, float(attained.max()))
        wide = (bound > max(proven, best) + RESOLUTION) if depth < DEPTH else np.zeros(len(bound), dtype=bool)
        proven = max(proven, float(bound[~wide].max(initial=0.0)))
        if not wide.any():
            break
        leaves = path.halve(pairs, leaves.take(wide))
    return proven


def _ratio(pairs: Pairs, rows: NDArray[np.intp], clearance: Floats, speed: Floats, stop: Stopping) -> Floats:
    protective = stop.approach_m(pairs.intrusion[rows]) + stop.travel_m(speed)
    possible = clearance - pairs.uncertainty[rows] < protective
    return np.asarray(np.where(possible, speed / pairs.limit_speed[rows], 0.0))

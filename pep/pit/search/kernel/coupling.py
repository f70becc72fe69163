"""Index of a pair on a span with clearance and speed taken at the same place.

It is exact to the second order.

`search` asks first for each at its own worst place of the span, which is off by their change over it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pep.pit.base.pair_columns import MEANT, PERSON, PLANE, RADII, TRAVEL
from pep.pit.base.tier import LEAST_TRAVEL_M, TIE
from pep.pit.geometry.clearance import ROUNDING_M
from pep.pit.path.straight_path import GRID
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.kernel.arithmetic.compilation import lent
from pep.pit.search.kernel.arithmetic.core_distance import ahead, support
from pep.pit.search.kernel.arithmetic.index_law import pair_index, tangent
from pep.pit.search.kernel.search_columns import RADIUS, SECOND, SPIN_SECOND, THIRD

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.core_distance import Gap

REACHED: Final = 3.0  # PHY-6: index from which the arm's own travel reaches a person


@lent
def in_step_index(
    ends: Floats,
    speeds: Floats,
    spins: Floats,
    table: Floats,
    laws: Floats,
    low: int,
    high: int,
    first: int,
    middle: int,
    last: int,
    body: int,
    pair: int,
    shape: int,
    kind: int,
    gap: Gap,
    bend: float,
    profile: Floats,
    law: Floats,
) -> float:
    """Index that the pair nowhere exceeds on the span [low, high], with clearance and speed place by place.

    On each half clearance and speed are no worse than somewhere on the line from what is returned of one node to what
    is of the other: distances along one direction and node speeds have chords, the rate has a tangent, and where speed
    per ds/dt falls while the rate rises their product is above its chord by a quarter of both changes. What an index
    allows of clearance and speed is convex (docs/physics.md, PHY-9), so the worse end of such a line is its worst.
    Infinite where it is not convex: of meant contacts, of people who are reached by the arm's own travel, at rest.
    """
    _, x, y, z = gap
    if kind == MEANT or (shape != PLANE and not x * x + y * y + z * z > 0.5):  # a unit vector, or zero
        return math.inf
    taken = support(laws, pair, shape, x, y, z) + laws[pair, RADII] + table[body, SECOND] * bend + ROUNDING_M
    radius, worst, width = table[body, RADIUS], 0.0, 0.5 * (high - low) / GRID
    slack = (table[body, THIRD] + radius * table[body, SPIN_SECOND]) * bend
    near = ahead(ends, first, body, x, y, z) - taken
    fast = speeds[first, body] + radius * spins[first, body] + slack
    for half in range(2):
        node = middle if half == 0 else last
        then_near = ahead(ends, node, body, x, y, z) - taken
        then_fast = speeds[node, body] + radius * spins[node, body] + slack
        rate, slope = tangent(low / GRID + (half + 0.5) * width, profile)
        turn = 0.5 * slope * width
        above = 0.25 * max(0.0, (fast - then_fast) * 2.0 * turn)
        speed, then_speed = fast * (rate - turn) + above, then_fast * (rate + turn) + above
        if not min(speed, then_speed) * law[TRAVEL] > LEAST_TRAVEL_M:
            return math.inf
        worst = max(worst, pair_index(kind, laws, pair, near, speed, law))
        worst = max(worst, pair_index(kind, laws, pair, then_near, then_speed, law))
        near, fast = then_near, then_fast
    return math.inf if kind == PERSON and worst >= REACHED else worst


@lent
def lowered(bound: float, in_step: float, best: float) -> float:
    """Lower of two bounds, but not below the roof under which a row counts as settled.

    So a question about a part of the way with the plainer bound alone has as much room.
    """
    roof = max(best, min(best + RESOLUTION, math.ceil(best - TIE)))
    return min(bound, max(in_step, roof))

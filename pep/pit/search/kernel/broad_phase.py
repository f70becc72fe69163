"""Broad phase of a search: the pairs that may count on each span of the first cut, by balls.

Most pairs are far apart on the whole path. So the balls around all cores lie side by side, in `Field.balls`, and are
compared on all spans at once.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.pair_columns import (
    APART,
    AROUND,
    BALL,
    BALL_BODY,
    BALL_PERSON,
    BODY,
    BRAKE,
    CENTER,
    KIND,
    PERSON_SPEED,
    PLANE,
    RADII,
    REACTION,
    SHAPE,
    TRAVEL,
    VIOLATED_BELOW,
)
from pep.pit.search.kernel.arithmetic.body_poses import LINKS, place, squares
from pep.pit.search.kernel.arithmetic.compilation import compiled, lent
from pep.pit.search.kernel.arithmetic.core_distance import plane_gap
from pep.pit.search.kernel.arithmetic.index_law import calm_beyond, pair_index
from pep.pit.search.kernel.interval_tree import AT_MID, FIRST, HIGHEST_RATE, SPANS
from pep.pit.search.kernel.search_columns import (
    BALLS,
    BOUND,
    CLEAR,
    CLEAR_MID,
    HALF,
    PAIR,
    RUSH,
    RUSH_MID,
    SPAN_OF,
    STAGE,
    STRAYS,
    rough,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm, Nodes
    from pep.pit.search.kernel.arithmetic.pair_rows import Field, StraightPath
    from pep.pit.search.kernel.interval_tree import Tree
    from pep.pit.search.kernel.search_columns import SearchRows

    Whole = NDArray[np.int64]

# Columns of what is known of a body on each span of the first cut: in its middle the centre of the body's axis ...
_X: Final = 0
_Y: Final = FIRST
_Z: Final = 2 * FIRST
# ... with the speed, swerve and spin there, in whose place stand later: how far the body strays from the middle, its
# speed per unit of ds/dt, and where obstacles are far: those that rest, and people.
_SPEED: Final = 3 * FIRST
_SWERVE: Final = 4 * FIRST
_SPIN: Final = 5 * FIRST
_STRAYS: Final = _SPEED
_RUSH: Final = _SWERVE
_CLEAR_OF_THINGS: Final = _SPIN
_CLEAR_OF_PEOPLE: Final = 6 * FIRST
_KNOWN: Final = 7 * FIRST

EVERYWHERE: Final = (1 << FIRST) - 1  # far apart on all spans of the first cut

_FRAME: Final = 12 * FIRST  # numbers of a link's frame on all spans; as many of its turning follow


@compiled
def swept(nodes: Nodes, first: int, cut: int, arm: Arm, bodies: Whole) -> Floats:
    """Bodies in the middles of the first cut, with speed, swerve and spin: see the columns.

    The same as `arm.put`, and with the spans side by side, so that the processor does some of them at once.

    Args:
        nodes: the arm stands in `FIRST` configurations from `first` on.
        first: the first of them.
        arm, bodies: the arm, and the bodies in question.
    """
    frames, turning, links, swept = (
        nodes.frames,
        nodes.turning,
        np.empty((LINKS, 2 * _FRAME)),
        np.empty((arm.link.shape[0], _KNOWN)),
    )
    link, reference, own = arm.link, arm.reference, arm.ends
    for i in range(FIRST):
        for k in range(LINKS):
            for row in range(3):
                for column in range(4):
                    links[k, (4 * row + column) * FIRST + i] = frames[first + i, k, row, column]
                    links[k, _FRAME + (3 * column + row) * FIRST + i] = turning[first + i, k, column, row]
    for body in bodies:
        k, r = link[body], reference[body]
        ax, ay, az = own[body, 0, 0], own[body, 0, 1], own[body, 0, 2]
        bx, by, bz = own[body, 1, 0], own[body, 1, 1], own[body, 1, 2]
        for i in range(cut):
            rx, ry, rz = links[r, 12 * FIRST + i], links[r, 13 * FIRST + i], links[r, 14 * FIRST + i]
            mx, my, mz = links[r, 15 * FIRST + i], links[r, 16 * FIRST + i], links[r, 17 * FIRST + i]
            sx, sy, sz = links[k, 12 * FIRST + i] - rx, links[k, 13 * FIRST + i] - ry, links[k, 14 * FIRST + i] - rz
            cx, cy, cz = links[k, 15 * FIRST + i] - mx, links[k, 16 * FIRST + i] - my, links[k, 17 * FIRST + i] - mz
            dx = links[k, 18 * FIRST + i] - links[r, 18 * FIRST + i]
            dy = links[k, 19 * FIRST + i] - links[r, 19 * FIRST + i]
            dz = links[k, 20 * FIRST + i] - links[r, 20 * FIRST + i]
            ex = links[k, 21 * FIRST + i] - links[r, 21 * FIRST + i]
            ey = links[k, 22 * FIRST + i] - links[r, 22 * FIRST + i]
            ez = links[k, 23 * FIRST + i] - links[r, 23 * FIRST + i]
            fa, fb, fc, fd = links[k, i], links[k, FIRST + i], links[k, 2 * FIRST + i], links[k, 3 * FIRST + i]
            ga, gb, gc, gd = (
                links[k, 4 * FIRST + i],
                links[k, 5 * FIRST + i],
                links[k, 6 * FIRST + i],
                links[k, 7 * FIRST + i],
            )
            ha, hb, hc, hd = (
                links[k, 8 * FIRST + i],
                links[k, 9 * FIRST + i],
                links[k, 10 * FIRST + i],
                links[k, 11 * FIRST + i],
            )
            x, y, z = (
                fd + fa * ax + fb * ay + fc * az,
                gd + ga * ax + gb * ay + gc * az,
                hd + ha * ax + hb * ay + hc * az,
            )
            first_a, second_a = squares(x, y, z, rx, ry, rz, mx, my, mz, sx, sy, sz, cx, cy, cz, dx, dy, dz, ex, ey, ez)
            u, v, w = (
                fd + fa * bx + fb * by + fc * bz,
                gd + ga * bx + gb * by + gc * bz,
                hd + ha * bx + hb * by + hc * bz,
            )
            first_b, second_b = squares(u, v, w, rx, ry, rz, mx, my, mz, sx, sy, sz, cx, cy, cz, dx, dy, dz, ex, ey, ez)
            x, y, z = (
                0.5 * (x + u) - links[r, 3 * FIRST + i],
                0.5 * (y + v) - links[r, 7 * FIRST + i],
                0.5 * (z + w) - links[r, 11 * FIRST + i],
            )
            swept[body, _X + i] = links[r, i] * x + links[r, 4 * FIRST + i] * y + links[r, 8 * FIRST + i] * z
            swept[body, _Y + i] = links[r, FIRST + i] * x + links[r, 5 * FIRST + i] * y + links[r, 9 * FIRST + i] * z
            swept[body, _Z + i] = (
                links[r, 2 * FIRST + i] * x + links[r, 6 * FIRST + i] * y + links[r, 10 * FIRST + i] * z
            )
            swept[body, _SPEED + i] = math.sqrt(max(first_a, first_b))
            swept[body, _SWERVE + i] = math.sqrt(max(second_a, second_b))
            swept[body, _SPIN + i] = math.sqrt(sx * sx + sy * sy + sz * sz)
    return swept


@lent
def _reaching(swept: Floats, cut: int, bodies: Whole, rates: Floats, table: Floats, law: Floats) -> None:
    """Replaces the columns of the middles of the first cut's spans by those of whole spans."""
    approach = law[PERSON_SPEED] * (law[REACTION] + law[BRAKE])
    for body in bodies:
        for i in range(cut):
            strays, rush = rough(
                swept[body, _SPEED + i], swept[body, _SWERVE + i], swept[body, _SPIN + i], table, body, 1.0 / FIRST
            )
            speed = rush * rates[i, HIGHEST_RATE]
            clear = strays + table[body, HALF] + speed * law[TRAVEL]
            swept[body, _STRAYS + i], swept[body, _RUSH + i] = strays, rush
            swept[body, _CLEAR_OF_THINGS + i] = clear
            swept[body, _CLEAR_OF_PEOPLE + i] = clear + speed * law[REACTION] + approach


@lent
def _near(swept: Floats, cut: int, balls: Floats, pairs: Whole, near: Whole, far: Whole) -> int:
    """Counts the pairs that are near anywhere, writes them to `near`, and where each pair is far apart to `far`.

    A pair that is far apart counts no more than any motion there, and hides no violation.
    """
    used = 0
    for pair in pairs:
        body, people = int(balls[pair, BALL_BODY]), balls[pair, BALL_PERSON] > 0.0
        x, y, z, rest = balls[pair, BALL], balls[pair, BALL + 1], balls[pair, BALL + 2], balls[pair, APART]
        found = 0
        for i in range(cut):
            u, v, w = swept[body, _X + i] - x, swept[body, _Y + i] - y, swept[body, _Z + i] - z
            apart = rest + (swept[body, _CLEAR_OF_PEOPLE + i] if people else swept[body, _CLEAR_OF_THINGS + i])
            is_far = (apart >= 0.0) & (u * u + v * v + w * w >= apart * apart)
            found |= is_far << i
        near[used], far[pair] = pair, found
        used += found != EVERYWHERE
    return used


@compiled
def first_rows(
    tree: Tree, way: StraightPath, table: Floats, field: Field, pairs: Whole, law: Floats, rows: SearchRows, far: Whole
) -> None:
    """Rows of the first cut but those far apart, each known by its balls; `rows` has room for all.

    `far` gets, for each pair, the spans on which it is far apart, as bits.
    """
    count, numbers, whole, balls = pairs.shape[0], field.numbers, field.whole, field.balls
    spans, rates, nodes = tree.spans, tree.rates, tree.nodes
    moved, cut = np.zeros(table.shape[0], np.bool_), tree.counts[SPANS]
    for pair in pairs:
        moved[int(balls[pair, BALL_BODY])] = True
    bodies = np.flatnonzero(moved)
    known = swept(nodes, spans[0, AT_MID], cut, way.arm, bodies)
    _reaching(known, cut, bodies, rates, table, law)
    near = np.empty(count + 1, np.int64)
    count = _near(known, cut, balls, pairs, near, far)
    row_whole, row_numbers, doubts, ends = rows.whole, rows.numbers, rows.doubts, nodes.ends
    used = doubtful = 0
    for k in range(FIRST):
        at = spans[k, AT_MID]
        for each in range(count):
            pair = near[each]
            if far[pair] >> k & 1:
                continue
            body, kind, below = whole[pair, BODY], whole[pair, KIND], numbers[pair, VIOLATED_BELOW]
            strays, rush = known[body, _STRAYS + k], known[body, _RUSH + k]
            speed = rush * rates[k, HIGHEST_RATE]
            if whole[pair, SHAPE] == PLANE:
                place(nodes, at, way.arm, body)
                clear = plane_gap(ends, at, body, numbers, pair)[0] - numbers[pair, RADII] - strays
                if clear >= max(calm_beyond(kind, numbers, pair, speed, law), below):
                    far[pair] |= 1 << k
                    continue
            else:
                x, y = known[body, _X + k] - numbers[pair, CENTER], known[body, _Y + k] - numbers[pair, CENTER + 1]
                z = known[body, _Z + k] - numbers[pair, CENTER + 2]
                clear = math.sqrt(x * x + y * y + z * z) - strays
                clear -= table[body, HALF] + numbers[pair, AROUND] + numbers[pair, RADII]
            row_whole[used, SPAN_OF], row_whole[used, PAIR], row_whole[used, STAGE] = k, pair, BALLS
            row_numbers[used, CLEAR], row_numbers[used, RUSH] = clear, rush
            row_numbers[used, CLEAR_MID], row_numbers[used, RUSH_MID] = math.inf, 0.0
            row_numbers[used, STRAYS] = strays
            row_numbers[used, BOUND] = pair_index(kind, numbers, pair, clear, speed, law)
            if clear < below:
                doubts[doubtful] = used
                doubtful += 1
            used += 1
    rows.used[0], rows.used[1] = used, doubtful

"""Intervals of one path as a tree: each is halved once for all callers, each configuration computed once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.path.straight_path import GRID
from pep.pit.search.certify import FIRST_CUT_LEAST
from pep.pit.search.kernel.arithmetic.body_poses import more_nodes, pose
from pep.pit.search.kernel.arithmetic.compilation import compiled, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.index_law import highest_rate, rate_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Nodes
    from pep.pit.search.kernel.arithmetic.pair_rows import StraightPath

    Whole = NDArray[np.int64]

# Columns of a span: its ends in 1 / GRID, the nodes of its ends and middle, its first half, how often it was halved.
LOW: Final = 0
HIGH: Final = 1
AT_LOW: Final = 2
AT_MID: Final = 3
AT_HIGH: Final = 4
LEFT: Final = 5
LEVEL: Final = 6
SPAN: Final = 7

WHOLE_LEAF: Final = -1  # in `LEFT`: not halved
FIRST: Final = FIRST_CUT_LEAST  # spans of the first cut, a power of two
FIRST_LEVEL: Final = FIRST.bit_length() - 1

# Rates of a span: the highest on it, and that in its middle.
HIGHEST_RATE: Final = 0
MIDDLE_RATE: Final = 1
RATES: Final = 2

# Counters of a tree.
NODES: Final = 0
SPANS: Final = 1


class Tree(NamedTuple):
    """Spans of a path and its configurations.

    Attributes:
        nodes: the configurations.
        key: shape (n,), of each configuration, in 1 / GRID.
        posed: shape (n,), whether the links stand there yet.
        spans: shape (n, SPAN).
        rates: shape (n, RATES), ds/dt on each span, 1/s.
        counts: numbers of nodes and spans in use.
        q: room for one configuration.
    """

    nodes: Nodes
    key: Whole
    posed: Any
    spans: Whole
    rates: Floats
    counts: Whole
    q: Floats


@lent
def plant(tree: Tree, way: StraightPath, profile: Floats) -> None:
    """Makes the tree the first cut, in equal spans, with the arm in their middles."""
    tree.counts[NODES] = 0
    step, spans, rates = GRID // FIRST, tree.spans, tree.rates
    for k in range(FIRST + 1):
        _node_at(tree, k * step)
    for k in range(FIRST):
        spans[k, LOW], spans[k, HIGH], spans[k, LEFT] = k * step, (k + 1) * step, WHOLE_LEAF
        spans[k, LEVEL], spans[k, AT_LOW], spans[k, AT_HIGH] = FIRST_LEVEL, k, k + 1
        spans[k, AT_MID] = _node_at(tree, k * step + step // 2)
        stand(tree, way, spans[k, AT_MID])
        rate(spans, rates, k, profile)
    tree.counts[SPANS] = FIRST


@lent
def _node_at(tree: Tree, key: int) -> int:
    """Place of the new configuration at `key`; there is room for it."""
    used = tree.counts[NODES]
    tree.key[used], tree.posed[used] = key, False
    tree.counts[NODES] = used + 1
    return used


@lent
def stand(tree: Tree, way: StraightPath, node: int) -> None:
    """Places the links there, and no body yet."""
    s = tree.key[node] / GRID
    for joint in range(tree.q.shape[0]):
        tree.q[joint] = way.start[joint] + s * way.delta[joint]
    pose(tree.nodes, node, way.arm, tree.q, way.delta)
    tree.posed[node] = True


@lent
def rate(spans: Whole, rates: Floats, span: int, profile: Floats) -> None:
    """Sets the span's rates to this profile's."""
    low, high = spans[span, LOW], spans[span, HIGH]
    rates[span, HIGHEST_RATE] = highest_rate(low / GRID, high / GRID, profile)
    rates[span, MIDDLE_RATE] = rate_at((low + high) // 2 / GRID, profile)


@compiled
def with_room(tree: Tree) -> Tree:
    """The same tree with room for another span's halves."""
    nodes, key, posed, spans, rates = tree.nodes, tree.key, tree.posed, tree.spans, tree.rates
    count = nodes.speed.shape[0]
    if tree.counts[NODES] + 2 > count:
        nodes = more_nodes(nodes)
        key, posed = np.empty(2 * count, np.int64), np.empty(2 * count, np.bool_)
        copy_into(key, tree.key)
        copy_into(posed, tree.posed)
    count = spans.shape[0]
    if tree.counts[SPANS] + 2 > count:
        spans, rates = np.empty((2 * count, SPAN), np.int64), np.empty((2 * count, RATES))
        copy_into(spans, tree.spans)
        copy_into(rates, tree.rates)
    return Tree(nodes, key, posed, spans, rates, tree.counts, tree.q)


@lent
def is_full(tree: Tree) -> bool:
    """True where there is no room for another span's halves."""
    return tree.counts[NODES] + 2 > tree.nodes.speed.shape[0] or tree.counts[SPANS] + 2 > tree.spans.shape[0]


@lent
def halve(tree: Tree, way: StraightPath, profile: Floats, span: int) -> int:
    """The first half of the span, which the second follows; there is room for them."""
    spans = tree.spans
    if spans[span, LEFT] != WHOLE_LEAF:
        return spans[span, LEFT]
    left, level = tree.counts[SPANS], spans[span, LEVEL] + 1
    low, high = spans[span, LOW], spans[span, HIGH]
    mid = (low + high) // 2
    for side in range(2):
        at = left + side
        begin, end = (low, mid) if side == 0 else (mid, high)
        spans[at, LOW], spans[at, HIGH], spans[at, LEFT], spans[at, LEVEL] = begin, end, WHOLE_LEAF, level
        spans[at, AT_LOW] = spans[span, AT_LOW] if side == 0 else spans[span, AT_MID]
        spans[at, AT_HIGH] = spans[span, AT_MID] if side == 0 else spans[span, AT_HIGH]
        spans[at, AT_MID] = _node_at(tree, (begin + end) // 2)
        stand(tree, way, spans[at, AT_MID])
        rate(spans, tree.rates, at, profile)
    spans[span, LEFT] = left
    tree.counts[SPANS] = left + 2
    return left

"""The intervals of one path as a tree: each is halved once, whoever asks, and each configuration is computed once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.kernel.arm import more_nodes, no_nodes, pose
from pep.pit.kernel.compiled import compiled
from pep.pit.path import GRID

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.kernel.arm import Nodes
    from pep.pit.kernel.rows import Way
    from pep.pit.motion import Floats

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
NODES_FIRST: Final = 128  # room for configurations at first; most questions need fewer

# Counters of a tree.
NODES: Final = 0
SPANS: Final = 1


class Tree(NamedTuple):
    """Spans of a path and its configurations.

    Attributes:
        nodes: the configurations.
        spans: shape (n, SPAN).
        counts: how many nodes and spans are in use.
        q: room for one configuration.
    """

    nodes: Nodes
    spans: Whole
    counts: Whole
    q: Floats


@compiled
def no_tree(bodies: int, joints: int) -> Tree:
    """Room for a tree."""
    return Tree(
        no_nodes(NODES_FIRST, bodies),
        np.empty((NODES_FIRST, SPAN), np.int64),
        np.zeros(2, np.int64),
        np.empty(joints),
    )


@compiled
def plant(tree: Tree, way: Way, first: int, level: int) -> None:
    """The tree is `first` equal spans, 2 to the power of `level`, with all their configurations."""
    tree.counts[NODES] = 0
    step = GRID // first
    for k in range(first + 1):
        node_at(tree, way, k * step)
    spans = tree.spans
    for k in range(first):
        spans[k, LOW], spans[k, HIGH], spans[k, LEFT], spans[k, LEVEL] = k * step, (k + 1) * step, WHOLE_LEAF, level
        spans[k, AT_LOW], spans[k, AT_HIGH] = k, k + 1
        spans[k, AT_MID] = node_at(tree, way, k * step + step // 2)
    tree.counts[SPANS] = first


@compiled
def node_at(tree: Tree, way: Way, key: int) -> int:
    """Where the configuration at `key`, a new one, stands from now on; there is room for it."""
    used = tree.counts[NODES]
    for joint in range(tree.q.shape[0]):
        tree.q[joint] = way.start[joint] + key / GRID * way.delta[joint]
    pose(tree.nodes, used, way.arm, tree.q, way.delta)
    tree.counts[NODES] = used + 1
    return used


@compiled
def with_room(tree: Tree) -> Tree:
    """The same tree with room for another span's halves."""
    nodes, spans = tree.nodes, tree.spans
    if tree.counts[NODES] + 2 > nodes.speed.shape[0]:
        nodes = more_nodes(nodes)
    if tree.counts[SPANS] + 2 > spans.shape[0]:
        spans = np.empty((2 * tree.spans.shape[0], SPAN), np.int64)
        spans[: tree.spans.shape[0]] = tree.spans
    return Tree(nodes, spans, tree.counts, tree.q)


@compiled
def is_full(tree: Tree) -> bool:
    """Whether there is no room for another span's halves."""
    return tree.counts[NODES] + 2 > tree.nodes.speed.shape[0] or tree.counts[SPANS] + 2 > tree.spans.shape[0]


@compiled
def halve(tree: Tree, way: Way, span: int) -> int:
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
        spans[at, AT_MID] = node_at(tree, way, (begin + end) // 2)
    spans[span, LEFT] = left
    tree.counts[SPANS] = left + 2
    return left

"""Heap of rows by a key, the highest first."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pep.pit.search.kernel.arithmetic.compilation import compiled, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats


class Heap(NamedTuple):
    """Keys and rows, of which the first `used[0]` are in use."""

    key: Floats
    row: NDArray[np.int64]
    used: NDArray[np.int64]


@compiled
def with_room(heap: Heap, room: int) -> Heap:
    """The same with room for so many rows at least."""
    if heap.key.shape[0] >= room:
        return heap
    wide = Heap(np.empty(2 * room), np.empty(2 * room, np.int64), heap.used)
    count = heap.used[0]
    copy_into(wide.key, heap.key[:count])
    copy_into(wide.row, heap.row[:count])
    return wide


@lent
def push(keys: Floats, rows: NDArray[np.int64], count: NDArray[np.int64], key: float, row: int) -> None:
    """Adds the row to the heap; there is room for it."""
    at = count[0]
    count[0] = at + 1
    while at > 0:
        above = (at - 1) // 2
        if keys[above] >= key:
            break
        keys[at], rows[at] = keys[above], rows[above]
        at = above
    keys[at], rows[at] = key, row


@lent
def heaped(keys: Floats, rows: NDArray[np.int64], count: NDArray[np.int64], first: Floats) -> None:
    """Makes the rows 0, 1 ... with these keys the heap; there is room for them."""
    count[0] = first.shape[0]
    for row in range(first.shape[0]):
        keys[row], rows[row] = first[row], row
    for at in range(first.shape[0] // 2 - 1, -1, -1):
        _sift(keys, rows, first.shape[0], at, keys[at], rows[at])


@lent
def lower(keys: Floats, rows: NDArray[np.int64], count: NDArray[np.int64], key: float) -> None:
    """Sets the key of the first row to `key`, which is no higher than before."""
    _sift(keys, rows, count[0], 0, key, rows[0])


@lent
def pop(keys: Floats, rows: NDArray[np.int64], count: NDArray[np.int64]) -> None:
    """Takes the first row from the heap, which is not empty."""
    last = count[0] - 1
    count[0] = last
    _sift(keys, rows, last, 0, keys[last], rows[last])


@lent
def _sift(keys: Floats, rows: NDArray[np.int64], count: int, at: int, key: float, row: int) -> None:
    """Sinks the row from `at` to its place below higher ones."""
    while True:
        below = 2 * at + 1
        if below >= count:
            break
        if below + 1 < count and keys[below + 1] > keys[below]:
            below += 1
        if keys[below] < key:  # among equals the one that was looked at least
            break
        keys[at], rows[at] = keys[below], rows[below]
        at = below
    keys[at], rows[at] = key, row

"""Merkle tree over the entries of a log: hashes, paths, and what paths prove (RFC 9162 section 2.1, [LOG-1]).

A tree is read through its complete subtrees: `Node` gives the hash of the 2^level leaves from index * 2^level on.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Final

from capabilities.values.errors import FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Node = Callable[[int, int], bytes]

HASH_BYTES: Final = 32
LEAF: Final = b"\x00"
INNER: Final = b"\x01"
"""Prefixes that keep a leaf and an inner node apart (RFC 9162 section 2.1.1)."""
EMPTY_ROOT: Final = hashlib.sha256(b"").digest()
"""Root of the tree without entries (RFC 9162 section 2.1.1)."""
LONGEST_PATH: Final = 64
"""Most hashes of a path: sizes are below 2^63, and a proof of consistency has one more than levels."""


def leaf_hash(entry: bytes) -> bytes:
    """Hash of the leaf of an entry."""
    return hashlib.sha256(LEAF + entry).digest()


def inner_hash(left: bytes, right: bytes) -> bytes:
    """Hash of the node above two nodes."""
    return hashlib.sha256(INNER + left + right).digest()


def root(size: int, node: Node) -> bytes:
    """Root of the tree of the first `size` leaves."""
    return EMPTY_ROOT if size == 0 else _range(0, size, node)


def inclusion(index: int, size: int, node: Node) -> list[bytes]:
    """Path from the leaf at `index` (from 0) to the root of the first `size` leaves (RFC 9162 section 2.1.3.1).

    Raises:
        ValueError: where no such leaf is in that tree.
    """
    if not 0 <= index < size:
        raise ValueError(index)
    path, begin, end = list[bytes](), 0, size
    while end - begin > 1:
        middle = begin + _split(end - begin)
        if index < middle:
            path.append(_range(middle, end, node))
            end = middle
        else:
            path.append(_range(begin, middle, node))
            begin = middle
    return path[::-1]


def consistency(old: int, new: int, node: Node) -> list[bytes]:
    """Proof that the tree of `old` leaves is the beginning of that of `new` ones (RFC 9162 section 2.1.4.1).

    Empty where one of the two says nothing: `old` is 0 or `new`.

    Raises:
        ValueError: unless 0 <= old <= new.
    """
    if not 0 <= old <= new:
        raise ValueError(old)
    if old in (0, new):
        return []
    path, begin, end, whole = list[bytes](), 0, new, True
    while end != old:
        middle = begin + _split(end - begin)
        if old <= middle:
            path.append(_range(middle, end, node))
            end = middle
        else:
            path.append(_range(begin, middle, node))
            begin, whole = middle, False
    if not whole:
        path.append(_range(begin, end, node))
    return path[::-1]


def check_inclusion(leaf: bytes, index: int, size: int, path: Sequence[bytes], root: bytes) -> None:
    """Checks that the leaf stands at `index` in the tree of `size` leaves with this root (RFC 9162 section 2.1.3.2).

    Raises:
        StatementError: `STATEMENT_UNTRUSTED` where the path does not lead from the leaf to the root.
    """
    if not 0 <= index < size:
        raise _no("no such entry in a tree of this size")
    number, last, found = index, size - 1, leaf
    for each in _of_hashes(path):
        if last == 0:
            raise _no("a path that goes on above the root")
        if number & 1 or number == last:
            found = inner_hash(each, found)
            while not number & 1 and number:
                number, last = number >> 1, last >> 1
        else:
            found = inner_hash(found, each)
        number, last = number >> 1, last >> 1
    if last != 0 or found != root:
        raise _no("the path does not lead to the root")


def check_consistency(old: int, new: int, path: Sequence[bytes], old_root: bytes, new_root: bytes) -> None:
    """Checks that the old tree is the beginning of the new one (RFC 9162 section 2.1.4.2).

    Raises:
        StatementError: `STATEMENT_UNTRUSTED` where it is not proven.
    """
    if not 0 <= old <= new:
        raise _no("the old tree is larger than the new one")
    if old in (0, new):
        known = EMPTY_ROOT if old == 0 else new_root
        if path or old_root != known:
            raise _no("two trees of one size, or a proof about nothing")
        return
    hashes = list(_of_hashes(path))
    if old & (old - 1) == 0:
        hashes.insert(0, old_root)
    if not hashes:
        raise _no("a proof is missing")
    number, last = old - 1, new - 1
    while number & 1:
        number, last = number >> 1, last >> 1
    first = second = hashes[0]
    for each in hashes[1:]:
        if last == 0:
            raise _no("a proof that goes on above the root")
        if number & 1 or number == last:
            first, second = inner_hash(each, first), inner_hash(each, second)
            while not number & 1 and number:
                number, last = number >> 1, last >> 1
        else:
            second = inner_hash(second, each)
        number, last = number >> 1, last >> 1
    if last != 0 or first != old_root or second != new_root:
        raise _no("the new tree does not begin with the old one")


class GrowingTree:
    """Root of a tree that grows leaf by leaf, in memory of the logarithm of its size.

    Attributes:
        size: number of leaves.
    """

    def __init__(self) -> None:
        self.size = 0
        self._peaks: list[bytes] = []

    def append(self, leaf: bytes) -> None:
        """One more leaf, by its hash."""
        number, node = self.size, leaf
        while number & 1:
            node = inner_hash(self._peaks.pop(), node)
            number >>= 1
        self._peaks.append(node)
        self.size += 1

    def root(self) -> bytes:
        """Root of the tree as it is."""
        if not self._peaks:
            return EMPTY_ROOT
        node = self._peaks[-1]
        for peak in reversed(self._peaks[:-1]):
            node = inner_hash(peak, node)
        return node


def _range(begin: int, end: int, node: Node) -> bytes:
    """Hash over the leaves from `begin` to before `end`, a range that the tree's own splits lead to."""
    width = end - begin
    if width & (width - 1) == 0:
        level = width.bit_length() - 1
        return node(level, begin >> level)
    middle = begin + _split(width)
    return inner_hash(_range(begin, middle, node), _range(middle, end, node))


def _split(width: int) -> int:
    """Largest power of two below the width."""
    return 1 << ((width - 1).bit_length() - 1)


def _of_hashes(path: Sequence[bytes]) -> Sequence[bytes]:
    if len(path) > LONGEST_PATH or any(len(each) != HASH_BYTES for each in path):
        raise _no("no path of hashes")
    return path


def _no(why: str) -> StatementError:
    return StatementError(FaultCode.STATEMENT_UNTRUSTED, why)

"""Tuple that is hashed once: the memories of this package look up a token's content with every token."""

from __future__ import annotations

from typing import TypeVar

_T = TypeVar("_T")


class HashedTuple(tuple[_T, ...]):  # noqa: SLOT001 - its hash has to stand somewhere
    """Equal to the plain tuple of the same members, and found where that is.

    Attributes:
        passed: bounds that the members were found inside of, for who asks that of one object again and again.
    """

    passed: tuple[int, ...] = ()
    _hash: int | None = None

    def __hash__(self) -> int:
        if self._hash is None:
            self._hash = super().__hash__()
        return self._hash

    def __reduce__(self) -> tuple[type[tuple[_T, ...]], tuple[list[_T]]]:
        # Without the hash, which another process computes differently.
        return tuple, (list(self),)

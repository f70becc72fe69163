"""Bounds of one integer: membership, the meet of two, and the nearest value or bound.

A bound is a set of integers, and each set has one value: consecutive integers are a `Range`, others a `OneOf`. All
functions are total. An empty bound can be written but is in no well-formed scope; it has no member, and a function that
needs a member answers None.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.values.scope import Bound, OneOf, Range

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.scope import Limit

__all__ = [
    "bound_to_json",
    "canonical",
    "limits_to_json",
    "meet",
    "nearest",
    "nearest_bound",
    "one_of",
    "permits",
    "size",
    "within",
]


def permits(bound: Bound, value: int) -> bool:
    """True exactly for the integers inside `bound`."""
    match bound:
        case Range():
            return bound.low <= value <= bound.high
        case OneOf():
            return value in bound.values
        case _:
            assert_never(bound)


def size(bound: Bound) -> int:
    """Number of integers inside."""
    match bound:
        case Range(low, high):
            return max(0, high - low + 1)
        case OneOf(values):
            return len(values)
        case _:
            assert_never(bound)


def one_of(first: int, *others: int) -> Bound:
    """The bound of exactly these integers in its one form: a range when they are consecutive."""
    return _exactly(frozenset((first, *others)))


def _exactly(members: frozenset[int]) -> Bound:
    low, high = min(members), max(members)
    return Range(low, high) if high - low + 1 == len(members) else OneOf(members)


def canonical(bound: Bound) -> Bound | None:
    """The one form of the same integers; None when there is none."""
    match bound:
        case Range(low, high):
            return bound if low <= high else None
        case OneOf(values):
            return _exactly(values) if values else None
        case _:
            assert_never(bound)


def meet(a: Bound, b: Bound) -> Bound | None:
    """The integers inside both in their one form, or None when there is none. Commutative and associative."""
    if isinstance(a, OneOf):
        return _common(a.values, b)
    if isinstance(b, OneOf):
        return _common(b.values, a)
    low, high = max(a.low, b.low), min(a.high, b.high)
    return Range(low, high) if low <= high else None


def _common(values: frozenset[int], bound: Bound) -> Bound | None:
    kept = frozenset(value for value in values if permits(bound, value))
    return _exactly(kept) if kept else None


def within(child: Bound, parent: Bound) -> bool:
    """True when every integer inside `child` is inside `parent`."""
    match child:
        case OneOf(values):
            return all(permits(parent, value) for value in values)
        case Range(low, high):
            match parent:
                case Range():
                    return high < low or (parent.low <= low and high <= parent.high)
                case OneOf(values):
                    # Members are counted, so that a wide range is not walked.
                    return size(child) == sum(1 for value in values if low <= value <= high)
                case _:
                    assert_never(parent)
        case _:
            assert_never(child)


def nearest(bound: Bound, value: int) -> int | None:
    """The integer inside `bound` that is nearest to `value`, the lower of two equally near; None for an empty bound."""
    match bound:
        case Range(low, high):
            return min(max(value, low), high) if low <= high else None
        case OneOf(values):
            return min(values, key=lambda member: (abs(member - value), member), default=None)
        case _:
            assert_never(bound)


def nearest_bound(parent: Bound, wanted: Bound) -> Bound | None:
    """Part of `parent` nearest to `wanted`: their meet, or else the one integer at the least distance.

    Of two equally near the lower. None when either bound is empty.
    """
    both = meet(parent, wanted)
    if both is not None:
        return both
    candidates = parent.values if isinstance(parent, OneOf) else [nearest(parent, value) for value in _ends(wanted)]
    gaps = [
        (abs(value - other), value)
        for value in candidates
        if value is not None and (other := nearest(wanted, value)) is not None
    ]
    if not gaps:
        return None
    _, value = min(gaps)
    return Range(value, value)


def _ends(bound: Bound) -> Iterable[int]:
    match bound:
        case Range(low, high):
            return low, high
        case OneOf(values):
            return values
        case _:
            assert_never(bound)


def bound_to_json(bound: Bound) -> dict[str, object]:
    """The bound as plain JSON: ``{"low", "high"}`` or ``{"one_of"}`` in ascending order."""
    match bound:
        case Range(low, high):
            return {"low": low, "high": high}
        case OneOf(values):
            return {"one_of": sorted(values)}
        case _:
            assert_never(bound)


def limits_to_json(limits: Iterable[Limit]) -> list[dict[str, object]]:
    """Limits as plain JSON, in their order."""
    return [
        {"parameter": limit.parameter.name, "unit": str(limit.parameter.unit), **bound_to_json(limit.bound)}
        for limit in limits
    ]

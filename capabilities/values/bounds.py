"""Bounds of one parameter: membership, the meet of two, and the nearest value or bound.

A bound is a set of values, and each set has one form: consecutive integers are a `Range`, others a `OneOf`. Bounds of
different kinds have nothing in common. All functions are total. An empty bound can be written but is in no well-formed
scope; it has no member, and a function that needs a member answers None.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeAlias, assert_never

from capabilities.values import stems
from capabilities.values.scope import Bound, Each, Flags, OneOf, Range, Stems, Words
from capabilities.values.units import DeclaredUnit, Unit

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.scope import Limit
    from capabilities.values.units import Kind

__all__ = [
    "MANY",
    "Measured",
    "bound_to_json",
    "canonical",
    "kind_to_json",
    "limits_to_json",
    "meet",
    "nearest",
    "nearest_bound",
    "one_of",
    "permits",
    "size",
    "within",
]


Measured: TypeAlias = int | bool | str | tuple[int | bool | str, ...]
"""Value that a bound is asked of: an integer, truth value, word, list of them, or a free value's size."""
Integers: TypeAlias = Range | OneOf
MANY: Final = 2**64
"""More values than any range has: the size of a bound with more than can be counted."""


def permits(bound: Bound, value: Any) -> bool:
    """True exactly for the values inside `bound`.

    Args:
        bound: of one parameter.
        value: `Measured`, of the parameter's kind.
    """
    match bound:
        case Range():
            inside: bool = bound.low <= value <= bound.high
            return inside
        case OneOf() | Flags():
            return value in bound.values
        case Words() | Stems():
            return stems.permits(bound, value)
        case Each(element, least, most):
            members = element is None or all(permits(element, member) for member in value)
            return least <= len(value) <= most and members
        case _:
            assert_never(bound)


def size(bound: Bound) -> int:
    """Number of values inside, `MANY` where there are more than can be counted."""
    match bound:
        case Range(low, high):
            return max(0, high - low + 1)
        case OneOf(values) | Flags(values) | Words(values):
            return len(values)
        case Stems(values):
            return MANY if values else 0
        case Each():
            return _size_of_lists(canonical(bound))
        case _:
            assert_never(bound)


def _size_of_lists(bound: Bound | None) -> int:
    match bound:
        case Each(None):
            return 1
        case Each(element, least, most) if element is not None and least == most and size(element) == 1:
            return 1
        case None:
            return 0
        case _:
            return MANY


def one_of(first: int, *others: int) -> Bound:
    """The bound of exactly these integers in its one form: a range when they are consecutive."""
    return _exactly(frozenset((first, *others)))


def _exactly(members: frozenset[int]) -> Integers:
    low, high = min(members), max(members)
    return Range(low, high) if high - low + 1 == len(members) else OneOf(members)


def canonical(bound: Bound) -> Bound | None:
    """The one form of the same values; None when there is none."""
    match bound:
        case Range(low, high):
            return bound if low <= high else None
        case OneOf(values):
            return _exactly(values) if values else None
        case Flags(values):
            return bound if values else None
        case Words() | Stems():
            return stems.canonical(bound)
        case Each(element, least, most):
            return _lists(None if element is None else canonical(element), max(least, 0), most)
        case _:
            assert_never(bound)


def _lists(element: Any, least: int, most: int) -> Each | None:
    """The one form of a bound of lists: without members there is no bound of them."""
    if most > 0 and element is not None:
        return Each(element, least, most) if least <= most else None
    return Each(None, 0, 0) if least <= 0 <= most else None


def meet(a: Bound, b: Bound) -> Bound | None:
    """The values inside both in their one form, or None when there is none. Commutative and associative."""
    match a:
        case Range() | OneOf():
            return _meet_integers(a, b) if isinstance(b, (Range, OneOf)) else None
        case Flags(values):
            return canonical(Flags(values & b.values)) if isinstance(b, Flags) else None
        case Words() | Stems():
            return stems.meet(a, b) if isinstance(b, (Words, Stems)) else None
        case Each(element, least, most):
            if not isinstance(b, Each):
                return None
            both = None if element is None or b.element is None else meet(element, b.element)
            return _lists(both, max(least, b.least, 0), min(most, b.most))
        case _:
            assert_never(a)


def _meet_integers(a: Integers, b: Integers) -> Integers | None:
    if isinstance(a, OneOf):
        return _common(a.values, b)
    if isinstance(b, OneOf):
        return _common(b.values, a)
    low, high = max(a.low, b.low), min(a.high, b.high)
    return Range(low, high) if low <= high else None


def _common(values: frozenset[int], bound: Integers) -> Integers | None:
    kept = frozenset(value for value in values if permits(bound, value))
    return _exactly(kept) if kept else None


def within(child: Bound, parent: Bound) -> bool:
    """True when every value inside `child` is inside `parent`."""
    match child:
        case Range() | OneOf():
            return _within_integers(child, parent) if isinstance(parent, (Range, OneOf)) else size(child) == 0
        case Flags(values):
            return values <= parent.values if isinstance(parent, Flags) else not values
        case Words() | Stems():
            return stems.within(child, parent) if isinstance(parent, (Words, Stems)) else not child.values
        case Each():
            return _within_lists(canonical(child), canonical(parent))
        case _:
            assert_never(child)


def _within_integers(child: Integers, parent: Integers) -> bool:
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


def _within_lists(child: Bound | None, parent: Bound | None) -> bool:
    match child, parent:
        case None, _:
            return True
        case Each(), Each():
            inside = child.element is None or (parent.element is not None and within(child.element, parent.element))
            return inside and parent.least <= child.least and child.most <= parent.most
        case _:
            return False


def nearest(bound: Bound, value: Any) -> Any:
    """The value inside `bound` that is nearest to `value`; None where none is, and for an empty bound.

    Of integers the lower of two equally near; of words as `stems.nearest` says. A list is cut at its greatest length,
    and each member is the one nearest to it.

    Args:
        bound: of one parameter.
        value: `Measured`, of the parameter's kind.
    """
    match bound:
        case Range(low, high):
            return min(max(value, low), high) if low <= high else None
        case OneOf(values):
            return min(values, key=lambda member: (abs(member - value), member), default=None)
        case Flags(values):
            return value if value in values else next(iter(values), None)
        case Words() | Stems():
            return stems.nearest(bound, value)
        case Each(element, _, most):
            near = tuple(None if element is None else nearest(element, member) for member in value[: max(most, 0)])
            return near if None not in near and permits(bound, near) else None
        case _:
            assert_never(bound)


def nearest_bound(parent: Bound, wanted: Bound) -> Bound | None:
    """Part of `parent` nearest to `wanted`: their meet, or else the one value at the least distance.

    Of two equally near integers the lower. None when either bound is empty, and where no distance is: between words,
    and between lists.
    """
    both = meet(parent, wanted)
    if both is not None:
        return both
    match parent, wanted:
        case ((Range() | OneOf()), (Range() | OneOf())):
            return _nearest_integer(parent, wanted)
        case Flags(), Flags() if wanted.values:
            return canonical(parent)
        case _:
            return None


def _nearest_integer(parent: Integers, wanted: Integers) -> Bound | None:
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


def _ends(bound: Integers) -> Iterable[int]:
    match bound:
        case Range(low, high):
            return low, high
        case OneOf(values):
            return values
        case _:
            assert_never(bound)


# --- as JSON ---------------------------------------------------------------------------------------------------------


def bound_to_json(bound: Bound) -> dict[str, object]:
    """The bound as plain JSON, its members in ascending order.

    It is ``{"low", "high"}``, ``{"one_of"}``, ``{"starts_with"}``, ``{"under"}`` or ``{"each", "least", "most"}``.
    """
    match bound:
        case Range(low, high):
            return {"low": low, "high": high}
        case OneOf(values) | Flags(values) | Words(values):
            return {"one_of": sorted(values)}
        case Stems(values, ""):
            return {"starts_with": sorted(values)}
        case Stems(values):
            return {"under": sorted(values)}
        case Each(element, least, most):
            return {"each": None if element is None else bound_to_json(element), "least": least, "most": most}
        case _:
            assert_never(bound)


def kind_to_json(kind: Kind) -> dict[str, object]:
    """The kind as plain JSON: ``{"unit"}`` for a quantity's, ``{"kind"}`` for any other."""
    return {"unit" if isinstance(kind, (Unit, DeclaredUnit)) else "kind": str(kind)}


def limits_to_json(limits: Iterable[Limit]) -> list[dict[str, object]]:
    """Limits as plain JSON, in their order."""
    return [
        {"parameter": limit.parameter.name, **kind_to_json(limit.parameter.kind), **bound_to_json(limit.bound)}
        for limit in limits
    ]

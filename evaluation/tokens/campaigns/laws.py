"""Laws of the scope algebra, each a plain function that is true where it holds for the given values.

They ask the very functions of `capabilities` and only compare and add, so that they can be asked with integers (the
property tests do) and with symbols that stand for every integer (`campaigns.lattice` does). Bounds are not
empty and in their one form; scopes are well formed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.values import algebra, bounds, stems
from capabilities.values.bounds import MANY, permits, size, within
from capabilities.values.scope import Each, Flags, OneOf, Range, Scope, Stems, Words

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capabilities.values.scope import Bound, Grant
    from capabilities.values.stems import WordBound

_LONG: Final = "~" * 300
"""Longer than any word in a bound."""

# --- bounds ----------------------------------------------------------------------------------------------------------


def meet_is_the_intersection(a: Bound, b: Bound, value: int) -> bool:
    """A value is inside the meet exactly when it is inside both."""
    return inside(bounds.meet(a, b), value) == (permits(a, value) and permits(b, value))


def meet_is_the_greatest_below_both(a: Bound, b: Bound, c: Bound) -> bool:
    """The meet is within both, and any bound within both is within it."""
    both = bounds.meet(a, b)
    if both is None:
        return not (within(c, a) and within(c, b))
    return within(both, a) and within(both, b) and (not (within(c, a) and within(c, b)) or within(c, both))


def meet_commutes(a: Bound, b: Bound) -> bool:
    """The order of two does not matter, nor that a bound meets itself."""
    return bounds.meet(a, b) == bounds.meet(b, a) and bounds.meet(a, a) == a


def meet_associates(a: Bound, b: Bound, c: Bound) -> bool:
    """Nor does the order of three."""
    return _both(bounds.meet(a, b), c) == _both(a, bounds.meet(b, c))


def meet_is_monotone(a: Bound, b: Bound, c: Bound) -> bool:
    """A bound within another stays within it when both meet a third."""
    if not within(a, b):
        return True
    mine, other = bounds.meet(a, c), bounds.meet(b, c)
    return mine is None or (other is not None and within(mine, other))


def within_is_subset(a: Bound, b: Bound, value: int) -> bool:
    """`within` is asked of all values: none is left out when it holds, and one is when it does not."""
    if within(a, b):
        return not permits(a, value) or permits(b, value)
    return left_out(b, a) is not None


def within_is_antisymmetric(a: Bound, b: Bound) -> bool:
    """Two bounds with the same inside are the same value."""
    return not (within(a, b) and within(b, a)) or a == b


def within_is_transitive(a: Bound, b: Bound, c: Bound) -> bool:
    """A bound within a second one that is within a third is within the third; each is within itself."""
    return within(a, a) and (not (within(a, b) and within(b, c)) or within(a, c))


def less_is_left_out(a: Bound, b: Bound) -> bool:
    """Law of sizes: of two bounds, one within the other, only the equal one leaves out no value.

    More values than can be counted are of one size.
    """
    if not within(a, b):
        return True
    less = left_out(a, b) is not None
    if isinstance(a, Range | OneOf) and isinstance(b, Range | OneOf):
        return (size(a) < size(b)) == less
    return less == (a != b) and (size(a) < size(b)) == (less and size(a) != MANY)


def nearest_is_nearest(a: Bound, value: int, other: int) -> bool:
    """The nearest is inside; no other inside is nearer, and none as near is lower."""
    found = bounds.nearest(a, value)
    if found is None or not permits(a, found):
        return False
    gap, farther = abs(found - value), abs(other - value)
    return not permits(a, other) or gap < farther or (gap == farther and found <= other)


def nearest_bound_is_nearest(parent: Bound, wanted: Bound, inner: int, asked: int) -> bool:
    """Nearest bound: the meet when there is one, and else one permitted value at the least distance.

    No permitted value is nearer to the wanted bound.
    """
    found, both = bounds.nearest_bound(parent, wanted), bounds.meet(parent, wanted)
    if found is None or not within(found, parent):
        return False
    if both is not None:
        return found == both
    value = bounds.nearest(found, asked)
    if value is None or size(found) != 1 or not (permits(parent, inner) and permits(wanted, asked)):
        return value is not None and size(found) == 1
    near = bounds.nearest(wanted, value)
    return near is not None and abs(value - near) <= abs(inner - asked)


def words_meet_in_the_intersection(a: WordBound, b: WordBound, word: str) -> bool:
    """A word is inside the meet exactly when it is inside both."""
    both = stems.meet(a, b)
    return (both is not None and stems.permits(both, word)) == (stems.permits(a, word) and stems.permits(b, word))


def words_meet_in_the_greatest(a: WordBound, b: WordBound, c: WordBound) -> bool:
    """The meet of words is within both, and any bound within both is within it."""
    both, lower = stems.meet(a, b), stems.within(c, a) and stems.within(c, b)
    if both is None:
        return not lower
    return stems.within(both, a) and stems.within(both, b) and (not lower or stems.within(c, both))


def words_meet_in_any_order(a: WordBound, b: WordBound, c: WordBound) -> bool:
    """The meet of words is commutative, associative and idempotent."""
    ab, bc = stems.meet(a, b), stems.meet(b, c)
    left = None if ab is None else stems.meet(ab, c)
    right = None if bc is None else stems.meet(a, bc)
    return ab == stems.meet(b, a) and left == right and stems.meet(a, a) == a


def words_narrow_in_an_order(a: WordBound, b: WordBound, c: WordBound) -> bool:
    """The order of words is reflexive, antisymmetric and transitive."""
    onward = stems.within(a, b) and stems.within(b, c)
    same = stems.within(a, b) and stems.within(b, a)
    return stems.within(a, a) and (not same or a == b) and (not onward or stems.within(a, c))


def every_nearest_is_inside(parent: Bound, wanted: Bound, value: Any) -> bool:
    """A nearest value is inside, and the value itself where that is; a nearest bound is within, and the meet."""
    found, near, both = bounds.nearest(parent, value), bounds.nearest_bound(parent, wanted), bounds.meet(parent, wanted)
    return (
        (found is None or permits(parent, found))
        and (not permits(parent, value) or found == value)
        and (near is None or within(near, parent))
        and (both is None or near == both)
    )


def inside(bound: Bound | None, value: Any) -> bool:
    """True where the value is inside a bound that may be None."""
    return bound is not None and permits(bound, value)


def left_out(child: Bound, parent: Bound) -> Any:
    """A value of `parent` that is not inside `child`, or None when there is none."""
    return next(
        (value for value in _candidates(child, parent) if permits(parent, value) and not permits(child, value)), None
    )


def _candidates(child: Bound, parent: Bound) -> Iterator[Any]:
    """Values of which one is left out, if any value of `parent` is."""
    match parent:
        case Range(low, high):
            yield low
            yield high
            if isinstance(child, OneOf):
                # A range whose low end is in the set leaves it after some member for the first time.
                yield from (value + 1 for value in child.values)
        case OneOf(values) | Flags(values) | Words(values):
            yield from values
        case Stems(values, divider):
            # A stem is left out, or one of the child's leads to it; a set has some words after it, and not the longest.
            for stem in values:
                yield from (stem, f"{stem}{divider}{_LONG}")
        case Each(element, least, most):
            yield () if element is None else (_a_member(element),) * least
            if element is not None:
                yield (_a_member(element),) * most
                other = child.element if isinstance(child, Each) else None
                missing = _a_member(element) if other is None else left_out(other, element)
                if missing is not None:
                    yield (missing,) * max(least, 1)


def _both(a: Bound | None, b: Bound | None) -> Bound | None:
    return None if a is None or b is None else bounds.meet(a, b)


# --- scopes ----------------------------------------------------------------------------------------------------------


class Request:
    """Request to a scope: an operation with one value for each parameter, its tier, time and server."""

    def __init__(self, pair: tuple[str, str], values: tuple[Any, ...], tier: Any, at: Any, audience: Any) -> None:
        self.pair, self.values, self.tier, self.at, self.audience = pair, values, tier, at, audience


def allowed(scope: Scope, request: Request) -> bool:
    """True where a scope permits a request: the plain reading of docs/spec.md 1.2, written a second time."""
    grants = [grant for grant in scope.grants if (grant.object, grant.operation) == request.pair]
    return (
        len(grants) == 1
        and len(grants[0].limits) == len(request.values)
        and all(permits(limit.bound, value) for limit, value in zip(grants[0].limits, request.values, strict=True))
        and request.tier <= scope.ceiling
        and scope.not_before <= request.at < scope.not_after
        and request.audience in scope.audiences
    )


def a_child_permits_no_more(child: Scope, parent: Scope, request: Request) -> bool:
    """A parent permits every request that its child permits, and every delegate of its child."""
    if algebra.narrows(child, parent).widenings:
        return True
    return (not allowed(child, request) or allowed(parent, request)) and child.delegates <= parent.delegates


def scopes_meet_in_the_intersection(a: Scope, b: Scope, request: Request) -> bool:
    """The meet permits exactly the requests that both permit; without a meet they permit none in common."""
    both = algebra.meet(a, b)
    return (both is not None and allowed(both, request)) == (allowed(a, request) and allowed(b, request))


def scopes_meet_in_the_greatest(a: Scope, b: Scope, c: Scope) -> bool:
    """The meet narrows both, and any scope that narrows both narrows it."""
    both = algebra.meet(a, b)
    lower = not algebra.narrows(c, a).widenings and not algebra.narrows(c, b).widenings
    if both is None:
        return not lower
    above = not algebra.narrows(both, a).widenings and not algebra.narrows(both, b).widenings
    return above and (not lower or not algebra.narrows(c, both).widenings)


def scopes_meet_in_any_order(a: Scope, b: Scope, c: Scope) -> bool:
    """The meet of scopes is commutative, associative and idempotent."""
    ab, bc = algebra.meet(a, b), algebra.meet(b, c)
    left = None if ab is None else algebra.meet(ab, c)
    right = None if bc is None else algebra.meet(a, bc)
    return ab == algebra.meet(b, a) and left == right and algebra.meet(a, a) == a


def narrowing_is_an_order(a: Scope, b: Scope, c: Scope) -> bool:
    """Reflexive and never strictly so; antisymmetric; transitive."""
    itself = algebra.narrows(a, a)
    below, above = not algebra.narrows(a, b).widenings, not algebra.narrows(b, a).widenings
    onward = not algebra.narrows(b, c).widenings
    return (
        not itself.widenings
        and not itself.strict
        and (not (below and above) or a == b)
        and (not (below and onward) or not algebra.narrows(a, c).widenings)
    )


def strict_is_less(child: Scope, parent: Scope, request: Request) -> bool:
    """A strictly narrower child refuses a request that its parent allows, another child none, while it is valid.

    A refusal is of a request, or of a delegate of a further hop.
    """
    found = algebra.narrows(child, parent)
    if found.widenings:
        return True
    if found.strict:
        # Of budgets no one request tells; what single ones imply is shown for courses of acts.
        return "budgets" in found.strict or refuses_something(child, parent)
    during = child.not_before <= request.at < child.not_after
    return parent.delegates <= child.delegates and (
        not during or not allowed(parent, request) or allowed(child, request)
    )


def refuses_something(child: Scope, parent: Scope) -> bool:
    """True where `child` refuses a request or delegate that `parent` allows within the window of `child`."""
    if any(delegate not in child.delegates for delegate in parent.delegates):
        return True
    return any(allowed(parent, request) and not allowed(child, request) for request in _witnesses(child, parent))


def _witnesses(child: Scope, parent: Scope) -> Iterator[Request]:
    """Requests of which `child` refuses one, if it refuses any that `parent` allows while both are valid."""
    start = child.not_before
    for grant in parent.grants:
        pair = grant.object, grant.operation
        values = tuple(_a_member(limit.bound) for limit in grant.limits)
        below = next((each for each in child.grants if (each.object, each.operation) == pair), None)
        for audience in parent.audiences:
            yield Request(pair, values, parent.ceiling, start, audience)
        for audience in child.audiences:
            yield from (Request(pair, other, child.ceiling, start, audience) for other in _values(values, below, grant))


def _values(values: tuple[int, ...], below: Grant | None, grant: Grant) -> Iterator[tuple[int, ...]]:
    if below is None or len(below.limits) != len(grant.limits):
        yield values
        return
    for place, (mine, above) in enumerate(zip(below.limits, grant.limits, strict=True)):
        missing = left_out(mine.bound, above.bound)
        if missing is not None:
            yield (*values[:place], missing, *values[place + 1 :])


def _a_member(bound: Bound) -> Any:
    match bound:
        case Range(low):
            return low
        case OneOf(values) | Flags(values) | Words(values) | Stems(values):
            return next(iter(values))
        case Each(element, least):
            return () if element is None else (_a_member(element),) * least

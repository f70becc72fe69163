"""Laws of one hop, its refusal and its repair: as `campaigns.laws`, for a parent and a restriction."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from capabilities.values import algebra, bounds, explanation
from capabilities.values.scope import Budget, Each, Flags, Grant, Limit, OneOf, Range, Restriction, Scope, Stems, Words

if TYPE_CHECKING:
    from capabilities.values.scope import Bound, Widening


def a_hop_is_the_meet(parent: Scope, restriction: Restriction) -> bool:
    """A hop that may be made has less depth, narrows strictly, and is the meet with its parent."""
    child = algebra.hop(parent, restriction)
    if not isinstance(child, Scope):
        return True
    found = algebra.narrows(child, parent)
    return (
        not found.widenings
        and bool(found.strict)
        and 0 <= child.depth < parent.depth
        and child.not_before < child.not_after
        and child == algebra.stated(parent, restriction) == algebra.apply(parent, restriction)
    )


def a_refused_hop_asks_too_much(parent: Scope, restriction: Restriction) -> bool:
    """A hop that may not be made has no depth or time, is somewhere wider, or takes nothing away."""
    found = algebra.hop(parent, restriction)
    if isinstance(found, Scope):
        return True
    child = algebra.stated(parent, restriction)
    compared = algebra.narrows(child, parent)
    fits = child.depth < parent.depth and child.not_before < child.not_after and parent.depth >= 1
    return not (fits and not compared.widenings and compared.strict) and bool(found.widenings) == (
        not fits or bool(compared.widenings)
    )


def repair_is_the_nearest(parent: Scope, restriction: Restriction) -> bool:
    """A repaired hop is accepted and states the meet; one without repair has no strictly narrower meet."""
    repaired = explanation.repair(parent, restriction)
    both = None
    if parent.depth >= 1:
        both = algebra.meet(replace(parent, depth=parent.depth - 1), algebra.stated(parent, restriction))
    if repaired is None:
        return both is None or not algebra.narrows(both, parent).strict
    return both is not None and algebra.hop(parent, repaired) == both == algebra.stated(parent, repaired)


def every_nearest_is_permitted(parent: Scope, restriction: Restriction) -> bool:
    """A hop in which every widening takes its nearest permitted value is not refused as wider."""
    found = algebra.hop(parent, restriction)
    if isinstance(found, Scope) or any(place.nearest is None for place in found.widenings):
        return True
    after = algebra.hop(parent, take_nearest(parent, restriction, found.widenings))
    return isinstance(after, Scope) or not after.widenings


def the_nearest_window_is_that_of_seconds(parent: Scope, restriction: Restriction) -> bool:
    """The nearest window has the seconds of the nearest bound."""
    found, child = algebra.hop(parent, restriction), algebra.stated(parent, restriction)
    if isinstance(found, Scope) or child.not_before >= child.not_after:
        return True
    seconds = bounds.nearest_bound(
        Range(parent.not_before, parent.not_after - 1), Range(child.not_before, child.not_after - 1)
    )
    named = [place.nearest for place in found.widenings if place.dimension == "window"]
    return not named or (isinstance(seconds, Range) and named == [[seconds.low, seconds.high + 1]])


def take_nearest(parent: Scope, restriction: Restriction, places: tuple[Widening, ...]) -> Restriction:
    """The restriction with the nearest that is permitted at each place."""
    taken: Any = restriction
    for place in places:
        near: Any = place.nearest
        match place.dimension:
            case "limits" | "budgets":
                grants = tuple(_with(parent, grant, place) for grant in taken.grants or ())
                taken = replace(taken, grants=grants)
            case "window":
                taken = replace(taken, not_before=near[0], not_after=near[1])
            case "audiences" | "delegates":
                taken = replace(taken, **{place.dimension: frozenset(near)})
            case _:
                taken = replace(taken, **{place.dimension: near})
    return taken  # type: ignore[no-any-return]


def _with(parent: Scope, grant: Grant, place: Widening) -> Grant:
    where, near = f"{grant.object}/{grant.operation}", place.nearest
    above = parent.find(grant.object, grant.operation)
    if above is None or not place.what.startswith(where):
        return grant
    if isinstance(near, list):
        if place.what != where:
            return grant
        if place.dimension == "budgets":
            return replace(grant, budgets=tuple(map(budget_of, near)))
        limits = zip(above.limits, near, strict=True)
        return replace(grant, limits=tuple(Limit(limit.parameter, bound_of(told)) for limit, told in limits))
    return replace(
        grant,
        limits=tuple(
            Limit(limit.parameter, bound_of(near)) if f"{where}/{limit.parameter.name}" == place.what else limit
            for limit in grant.limits
        ),
    )


def budget_of(told: Any) -> Budget:
    """The budget that plain JSON tells."""
    return Budget(told.get("parameter", ""), told["audience"], told["per_s"], told["most"])


def bound_of(told: Any) -> Bound:
    """The bound that plain JSON tells."""
    match told:
        case {"each": element, "least": least, "most": most}:
            inside: Any = None if element is None else bound_of(element)
            return Each(inside, least, most)
        case {"one_of": [bool(), *_] as values}:
            return Flags(frozenset(values))
        case {"one_of": [str(), *_] as values}:
            return Words(frozenset(values))
        case {"one_of": values}:
            return OneOf(frozenset(values))
        case {"starts_with": values}:
            return Stems(frozenset(values), "")
        case {"under": values}:
            return Stems(frozenset(values), "/")
        case _:
            return Range(told["low"], told["high"])

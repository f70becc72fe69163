"""Partial order *narrows* on scopes, their meet, and the rule of one hop.

Scopes are a meet-semilattice: `narrows` is the order, `meet` the greatest scope below two. `stated` lays a restriction
over its parent as it was written, wider places included; `hop` is the rule for delegation, the only one that there is;
`apply` gives the meet of a restriction with its parent. `capabilities.values.explanation` puts a refusal into words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, TypeAlias

from capabilities.values import bounds, budgets
from capabilities.values.bounds import bound_to_json, limits_to_json, nearest, permits, size, within
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.scope import Grant, Limit, Restriction, Scope, Widening, make_scope
from capabilities.values.well_formed import TIME_LIMIT, well_formed, well_formed_grants, well_formed_restriction

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "COUNTED",
    "TIME_LIMIT",
    "Narrowing",
    "apply",
    "bound_to_json",
    "hop",
    "meet",
    "narrows",
    "nearest",
    "permits",
    "size",
    "stated",
    "well_formed",
    "well_formed_grants",
    "well_formed_restriction",
    "within",
]

Grants: TypeAlias = tuple[Grant, ...]
LayOver: TypeAlias = "Callable[[Grants, Grants], tuple[Grants, Narrowing]]"
COUNTED: Final = ("grants", "limits", "budgets", "ceiling", "audiences", "delegates")
"""The dimensions in which a hop must take something away. Depth and window shrink at every hop anyway."""


@dataclass(frozen=True, slots=True)
class Narrowing:
    """Comparison of a child scope with its parent.

    Attributes:
        widenings: every place where the child has more. Empty when the child narrows the parent.
        strict: the dimensions out of `COUNTED` in which the child has strictly less; told of a child without widenings.
    """

    widenings: tuple[Widening, ...]
    strict: frozenset[str]


_SAME: Final = Narrowing((), frozenset())

# --- the order -------------------------------------------------------------------------------------------------------


def narrows(child: Scope, parent: Scope) -> Narrowing:
    """Every place where `child` has more than `parent`, and the dimensions in which it has strictly less."""
    return _compare(child, parent, parent.depth, _compare_grants(child.grants, parent.grants))


def _compare_grants(child: Grants, parent: Grants) -> Narrowing:
    """`narrows` of scopes that have these grants and are equal otherwise."""
    widenings: list[Widening] = []
    strict: set[str] = set()
    known = {(grant.object, grant.operation): grant for grant in parent}
    for grant in child:
        above = known.get((grant.object, grant.operation))
        if above is None:
            asked = limits_to_json(grant.limits)
            widenings.append(Widening("grants", f"{grant.object}/{grant.operation}", None, asked))
        elif grant is not above:
            _compare_limits(grant, above, widenings, strict)
    if len(child) < len(parent):
        strict.add("grants")
    return Narrowing(tuple(widenings), frozenset(strict))


def _compare(child: Scope, parent: Scope, depth: int, of_grants: Narrowing) -> Narrowing:
    """Comparison as of `narrows`, with `depth` as the parent's and the grants compared already."""
    widenings: list[Widening] = []
    strict: set[str] = set()
    if child.ceiling > parent.ceiling:
        widenings.append(Widening("ceiling", "ceiling", parent.ceiling, child.ceiling, parent.ceiling))
    elif child.ceiling < parent.ceiling:
        strict.add("ceiling")
    if child.audiences is not parent.audiences:
        _compare_names("audiences", child.audiences, parent.audiences, widenings, strict)
    if child.delegates is not parent.delegates:
        _compare_names("delegates", child.delegates, parent.delegates, widenings, strict)
    if child.depth > depth:
        widenings.append(Widening("depth", "depth", depth, child.depth, depth))
    if child.not_before < parent.not_before or child.not_after > parent.not_after:
        widenings.append(_window(child, parent))
    if not widenings and not strict:
        return of_grants
    return Narrowing((*of_grants.widenings, *widenings), of_grants.strict | strict)


def _compare_limits(child: Grant, parent: Grant, widenings: list[Widening], strict: set[str]) -> None:
    # A limit that the hop did not change is the parent's very object and needs no comparison.
    changed = [(below, above) for below, above in zip(child.limits, parent.limits, strict=False) if below is not above]
    if len(child.limits) != len(parent.limits) or any(below.parameter != above.parameter for below, above in changed):
        # Another signature is another operation: neither parameters nor units nor their order may change.
        widenings.append(_signature(child, parent))
        return
    for below, above in changed:
        if not within(below.bound, above.bound):
            widenings.append(_limit(f"{child.object}/{child.operation}", below, above))
        elif not within(above.bound, below.bound):
            strict.add("limits")
    if child.budgets is not parent.budgets:
        _compare_budgets(child, parent, widenings, strict)


def _compare_budgets(child: Grant, parent: Grant, widenings: list[Widening], strict: set[str]) -> None:
    if not budgets.within(child.budgets, parent.budgets):
        near = budgets.to_json(budgets.meet(child.budgets, parent.budgets))
        stated = budgets.to_json(parent.budgets), budgets.to_json(child.budgets)
        widenings.append(Widening("budgets", f"{child.object}/{child.operation}", *stated, near))
    elif not budgets.within(parent.budgets, child.budgets):
        strict.add("budgets")


def _compare_names(
    dimension: str, child: frozenset[str], parent: frozenset[str], widenings: list[Widening], strict: set[str]
) -> None:
    if not child <= parent:
        # No delegate is a scope, no audience is none.
        left = sorted(child & parent)
        permitted = None if dimension == "audiences" and not left else left
        widenings.append(Widening(dimension, dimension, sorted(parent), sorted(child), permitted))
    elif len(child) < len(parent):
        strict.add(dimension)


# --- where a child is wider ------------------------------------------------------------------------------------------


def _limit(where: str, below: Limit, above: Limit) -> Widening:
    near = bounds.nearest_bound(above.bound, below.bound)
    return Widening(
        "limits",
        f"{where}/{below.parameter.name}",
        bound_to_json(above.bound),
        bound_to_json(below.bound),
        None if near is None else bound_to_json(near),
        above.parameter.kind,
    )


def _signature(child: Grant, parent: Grant) -> Widening:
    """The nearest grant has the parent's parameters, with as much of the child's bounds as they have in common."""
    wanted = {limit.parameter: limit.bound for limit in child.limits}
    near = [
        Limit(
            limit.parameter, bounds.nearest_bound(limit.bound, wanted.get(limit.parameter, limit.bound)) or limit.bound
        )
        for limit in parent.limits
    ]
    return Widening(
        "limits",
        f"{child.object}/{child.operation}",
        limits_to_json(parent.limits),
        limits_to_json(child.limits),
        limits_to_json(near),
    )


def _window(child: Scope, parent: Scope) -> Widening:
    """Widening of the time window, with the nearest window that the parent allows.

    That is the part that both windows have in common, or else the one second of the parent's nearest to the child's.
    """
    start, end = max(child.not_before, parent.not_before), min(child.not_after, parent.not_after)
    if start >= end:
        start = min(max(child.not_before, parent.not_before), parent.not_after - 1)
        end = start + 1
    return Widening(
        "window",
        "window",
        [parent.not_before, parent.not_after],
        [child.not_before, child.not_after],
        [start, end] if parent.not_before < parent.not_after else None,
    )


# --- the meet --------------------------------------------------------------------------------------------------------


def meet(a: Scope, b: Scope) -> Scope | None:
    """Greatest scope below both, or None where no grant, no audience or no time would be left.

    A grant is in it when both have it with the same parameters, units and order, and some value is left of each
    parameter. Commutative, associative, idempotent; with None as the least element it is total.
    """
    grants = tuple(
        both
        for grant in a.grants
        if (other := b.find(grant.object, grant.operation)) is not None
        and (both := _meet_grants(grant, other)) is not None
    )
    audiences = a.audiences & b.audiences
    not_before, not_after = max(a.not_before, b.not_before), min(a.not_after, b.not_after)
    if not grants or not audiences or not not_before < not_after:
        return None
    return Scope(
        grants=grants,
        ceiling=min(a.ceiling, b.ceiling),
        audiences=audiences,
        delegates=a.delegates & b.delegates,
        depth=min(a.depth, b.depth),
        not_before=not_before,
        not_after=not_after,
    )


def _meet_grants(a: Grant, b: Grant) -> Grant | None:
    if a is b:
        return a
    if [limit.parameter for limit in a.limits] != [limit.parameter for limit in b.limits]:
        return None
    limits = []
    for mine, other in zip(a.limits, b.limits, strict=True):
        both = bounds.meet(mine.bound, other.bound)
        if both is None:
            return None
        limits.append(Limit(mine.parameter, both))
    return Grant(a.object, a.operation, tuple(limits), budgets.meet(a.budgets, b.budgets))


# --- one hop ---------------------------------------------------------------------------------------------------------


def lay_over(parent: Grants, restriction: Grants) -> tuple[Grants, Narrowing]:
    """Grants that a restriction keeps, completed from the parent, and their comparison with it.

    Costly beside the rest of `hop`, and the same for every token that lends the same.
    """
    known = {(grant.object, grant.operation): grant for grant in parent}
    child = HashedTuple([_lay_over(known.get((grant.object, grant.operation)), grant) for grant in restriction])
    return child, _compare_grants(child, parent)


def stated(parent: Scope, restriction: Restriction) -> Scope:
    """The child as the restriction states it, wider places included.

    A dimension that the restriction leaves out is the parent's very object, with one hop less of depth.
    """
    child, _ = _stated(parent, restriction, lay_over)
    return child


def _stated(parent: Scope, restriction: Restriction, lay: LayOver) -> tuple[Scope, Narrowing]:
    """The child as it is stated, and how its grants compare with the parent's."""
    grants, of_grants = parent.grants, _SAME
    if restriction.grants is not None:
        grants, of_grants = lay(parent.grants, restriction.grants)
    child = make_scope(
        grants,
        parent.ceiling if restriction.ceiling is None else restriction.ceiling,
        parent.audiences if restriction.audiences is None else restriction.audiences,
        parent.delegates if restriction.delegates is None else restriction.delegates,
        parent.depth - 1 if restriction.depth is None else restriction.depth,
        parent.not_before if restriction.not_before is None else restriction.not_before,
        parent.not_after if restriction.not_after is None else restriction.not_after,
    )
    return child, of_grants


def _lay_over(parent: Grant | None, child: Grant) -> Grant:
    """The parent's signature with the child's bounds; limits of parameters that the parent does not know come last."""
    if parent is None:
        return child
    if not child.limits and not child.budgets:
        return parent
    tightened = {limit.parameter.name: limit for limit in child.limits}
    limits = []
    for limit in parent.limits:
        tight = tightened.get(limit.parameter.name)
        if tight is None or tight.parameter != limit.parameter:
            limits.append(limit)
        else:
            limits.append(tight)
            del tightened[limit.parameter.name]
    kept = child.budgets or parent.budgets
    return Grant(parent.object, parent.operation, (*limits, *tightened.values()), kept)


def hop(parent: Scope, restriction: Restriction, *, lay: LayOver = lay_over) -> Scope | Narrowing:
    """The child scope of a hop that may be made, or how it fails (docs/spec.md 1.2, [TOK-6]).

    It may be made when the stated child is nowhere wider than the parent with one hop less of depth, has strictly less
    in one of `COUNTED`, and has time left. Then it is also the meet of the two. Otherwise `widenings` has every place
    where more was asked, with a window that is empty and a hop where no depth is left; it is empty itself when nothing
    was taken away.

    Args:
        parent: of the hop.
        restriction: of the hop.
        lay: `lay_over`, or one that remembers.
    """
    child, of_grants = _stated(parent, restriction, lay)
    found = _compare(child, parent, parent.depth - 1, of_grants)
    if parent.depth < 1:
        return replace(found, widenings=(*found.widenings, Widening("depth", "depth", 0, 1)))
    if child.not_before >= child.not_after and not any(place.dimension == "window" for place in found.widenings):
        return replace(found, widenings=(*found.widenings, _window(child, parent)))
    return found if found.widenings or not found.strict else child


def apply(parent: Scope, restriction: Restriction) -> Scope:
    """Meet of a restriction with its parent scope, one hop less deep.

    It need not be strictly below the parent.

    Raises:
        ScopeError: `TOO_MANY_HOPS` when the parent may not be delegated further; `NOT_NARROWER` when nothing is left.
    """
    if parent.depth < 1:
        raise ScopeError(FaultCode.TOO_MANY_HOPS, "no depth is left")
    both = meet(replace(parent, depth=parent.depth - 1), stated(parent, restriction))
    if both is None:
        raise ScopeError(FaultCode.NOT_NARROWER, "nothing is left")
    return both

"""Meet of scopes, and the rule of one hop.

Scopes are a meet-semilattice: `narrows` (`capabilities.values.narrowing`) is the order, `meet` the greatest scope below
two. `stated` lays a restriction over its parent as it was written, wider places included; `hop` is the rule for
delegation, the only one that there is; `apply` gives the meet of a restriction with its parent.
`capabilities.values.explanation` puts a refusal into words.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

from capabilities.values import bounds, budgets
from capabilities.values.bounds import bound_to_json, nearest, permits, size, within
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.narrowing import COUNTED, SAME, Grants, Narrowing, compare, compare_grants, narrows, window
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

LayOver: TypeAlias = "Callable[[Grants, Grants], tuple[Grants, Narrowing]]"

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
    return child, compare_grants(child, parent)


def stated(parent: Scope, restriction: Restriction) -> Scope:
    """The child as the restriction states it, wider places included.

    A dimension that the restriction leaves out is the parent's very object, with one hop less of depth.
    """
    child, _ = _stated(parent, restriction, lay_over)
    return child


def _stated(parent: Scope, restriction: Restriction, lay: LayOver) -> tuple[Scope, Narrowing]:
    """The child as it is stated, and how its grants compare with the parent's."""
    grants, of_grants = parent.grants, SAME
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
    found = compare(child, parent, parent.depth - 1, of_grants)
    if parent.depth < 1:
        return replace(found, widenings=(*found.widenings, Widening("depth", "depth", 0, 1)))
    if child.not_before >= child.not_after and not any(place.dimension == "window" for place in found.widenings):
        return replace(found, widenings=(*found.widenings, window(child, parent)))
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

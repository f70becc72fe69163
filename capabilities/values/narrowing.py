"""Narrowing: the partial order of scopes, and every place where a child is wider than its parent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

from capabilities.values import bounds, budgets
from capabilities.values.bounds import bound_to_json, limits_to_json, within
from capabilities.values.scope import Grant, Limit, Scope, Widening

Grants: TypeAlias = tuple[Grant, ...]
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


SAME: Final = Narrowing((), frozenset())
"""Comparison of what is equal."""


def narrows(child: Scope, parent: Scope) -> Narrowing:
    """Every place where `child` has more than `parent`, and the dimensions in which it has strictly less."""
    return compare(child, parent, parent.depth, compare_grants(child.grants, parent.grants))


def compare_grants(child: Grants, parent: Grants) -> Narrowing:
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


def compare(child: Scope, parent: Scope, depth: int, of_grants: Narrowing) -> Narrowing:
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
        widenings.append(window(child, parent))
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


def window(child: Scope, parent: Scope) -> Widening:
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

"""Order and meet of budgets: so many acts, or so much of a quantity, in any window of so long.

One budget implies another when every course of acts inside it is inside the other. A grant holds several, none of
which implies another; all of them count. docs/spec.md 1.2 states order, meet and form.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

from capabilities.values.scope import Budget, Each, Flags, Grant, OneOf, Range, Scope, Stems, Words
from capabilities.values.units import DeclaredUnit, Unit

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.scope import Bound

Budgets: TypeAlias = tuple[Budget, ...]
LONGEST_S: Final = 604_800
"""Longest window, 7 days: the longest promise that a sponsor signs."""


def implies(tight: Budget, loose: Budget) -> bool:
    """True where every course of acts inside `tight` is inside `loose`.

    A window of `loose` is covered by so many windows of `tight`, rounded up, each of which may be full.
    """
    if (tight.parameter, tight.audience) != (loose.parameter, loose.audience):
        return False
    return tight.most * -(-loose.window_s // tight.window_s) <= loose.most


def within(child: Budgets, parent: Budgets) -> bool:
    """True where each of the parent's budgets is implied by one of the child's."""
    return all(any(implies(tight, loose) for tight in child) for loose in parent)


def least(budgets: Iterable[Budget]) -> Budgets:
    """The budgets that no other one of them implies, in order: the one form of all of them together."""
    some = sorted(set(budgets))
    return tuple(loose for loose in some if not any(tight != loose and implies(tight, loose) for tight in some))


def meet(a: Budgets, b: Budgets) -> Budgets:
    """The widest budgets below both."""
    return a if a == b else least((*a, *b))


def to_json(budgets: Budgets) -> list[dict[str, object]]:
    """Budgets as plain JSON; `parameter` is absent for a budget of acts."""
    return [
        {
            **({"parameter": each.parameter} if each.parameter else {}),
            "audience": each.audience,
            "most": each.most,
            "per_s": each.window_s,
        }
        for each in budgets
    ]


def defect(scope: Scope) -> str | None:
    """Defect of the budgets of a scope, or None.

    A budget is of a quantity of its grant that is never below 0, and each audience has a share of what another has.
    """
    for grant in scope.grants:
        if not grant.budgets:
            continue
        stated = {(each.parameter, each.audience) for each in grant.budgets}
        for measure in {parameter for parameter, _ in stated}:
            if measure and not _countable(grant, measure):
                return f"a budget of {measure}, which is no quantity from 0 of its grant"
            if any((measure, audience) not in stated for audience in scope.audiences):
                return "a budget without a share for each audience"
    return None


def shrinkable(scope: Scope) -> bool:
    """True unless each grant has the least budget of acts that there is, at each audience."""
    lowest = [Budget("", audience, LONGEST_S, 1) for audience in scope.audiences]
    return any(each not in grant.budgets for grant in scope.grants for each in lowest)


def _countable(grant: Grant, parameter: str) -> bool:
    for limit in grant.limits:
        if limit.parameter.name == parameter:
            return isinstance(limit.parameter.kind, (Unit, DeclaredUnit)) and _lowest(limit.bound) >= 0
    return False


def _lowest(bound: Bound) -> int:
    match bound:
        case Range(low, _):
            return low
        case OneOf(values):
            return min(values, default=-1)
        case Flags() | Words() | Stems() | Each():
            return -1

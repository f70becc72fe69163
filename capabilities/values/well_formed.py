"""Rules that every scope and restriction keeps, independent of its content: docs/spec.md 1.1 and 1.2."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.values import budgets, text
from capabilities.values.bounds import canonical
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.scope import (
    Bound,
    Budget,
    Each,
    Flags,
    Grant,
    OneOf,
    Range,
    Restriction,
    Scope,
    Stems,
    Tier,
    Words,
)
from capabilities.values.units import INT_LIMIT, DeclaredUnit, Kind, ListOf, Sort, Unit

if TYPE_CHECKING:
    from capabilities.values.caps import Caps
    from capabilities.values.scope import Limit

__all__ = ["TIME_LIMIT", "check_limit", "well_formed", "well_formed_grants", "well_formed_restriction"]

REMEMBERED: Final = 512
"""Grants of which is remembered that they are well formed."""
TIME_LIMIT: Final = 253_402_300_800
"""First second of the year 10000: no time in a token reaches it."""
_HIGHEST: Final = max(Tier)
LIST_LENGTH: Final = 256
"""Most members of a list in a request."""


def well_formed(scope: Scope, caps: Caps) -> Scope:
    """The scope itself, when it keeps every rule of the profile (docs/spec.md, [TOK-6]).

    Raises:
        ScopeError: `STATEMENT_MALFORMED` for shape, `OUT_OF_RANGE` for a number.
    """
    if not scope.grants:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a scope without grants")
    _check_grants(scope.grants, caps)
    if not scope.audiences:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a scope without audience")
    _check_names(scope.audiences, scope.delegates, caps.one_of, caps.text_bytes)
    _integer(scope.ceiling, 0, _HIGHEST, "ceiling")
    _integer(scope.depth, 0, caps.hops, "depth")
    _integer(scope.not_before, 0, TIME_LIMIT - 1, "not_before")
    _integer(scope.not_after, scope.not_before + 1, TIME_LIMIT - 1, "not_after")
    defect = budgets.defect(scope)
    if defect is not None:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, defect)
    return scope


def well_formed_restriction(restriction: Restriction, caps: Caps) -> Restriction:
    """The restriction itself, when each dimension that it states keeps the rules of the profile.

    Raises:
        ScopeError: as `well_formed`.
    """
    if restriction.grants is not None:
        well_formed_grants(restriction.grants, caps)
    if restriction.audiences is not None or restriction.delegates is not None:
        if restriction.audiences is not None and not restriction.audiences:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a restriction to no audience at all")
        audiences, delegates = restriction.audiences or frozenset(), restriction.delegates or frozenset()
        _check_names(audiences, delegates, caps.one_of, caps.text_bytes)
    if restriction.ceiling is not None:
        _integer(restriction.ceiling, 0, _HIGHEST, "ceiling")
    if restriction.depth is not None:
        _integer(restriction.depth, 0, caps.hops, "depth")
    if restriction.not_before is not None:
        _integer(restriction.not_before, 0, TIME_LIMIT - 1, "not_before")
    if restriction.not_after is not None:
        _integer(restriction.not_after, 0, TIME_LIMIT - 1, "not_after")
    return restriction


def well_formed_grants(grants: tuple[Grant, ...], caps: Caps) -> None:
    """Checks that the grants that a restriction states keep the rules of the profile.

    Raises:
        ScopeError: as `well_formed`.
    """
    if not grants:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a restriction to no grant at all")
    _check_grants(grants, caps)


def _integer(value: object, low: int, high: int, what: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"{what} outside {low}..{high}")


def _check_grants(grants: tuple[Grant, ...], caps: Caps) -> None:
    within = caps.grants, caps.parameters, caps.one_of, caps.text_bytes, caps.budgets
    if isinstance(
        grants, HashedTuple
    ):  # grants that were read are one object for all tokens that lend them; a refusal is not kept
        if grants.passed != within:
            _check_each(grants, caps)
            grants.passed = within
    else:
        _check_each(grants, caps)


def _check_each(grants: tuple[Grant, ...], caps: Caps) -> None:
    most, parameters, one_of, text_bytes = caps.grants, caps.parameters, caps.one_of, caps.text_bytes
    if len(grants) > most:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {most} grants")
    pairs = [(grant.object, grant.operation) for grant in grants]
    if pairs != sorted(set(pairs)):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "grants not sorted by object and operation, or one twice")
    for grant in grants:
        text.name(grant.object, most_bytes=text_bytes)
        text.name(grant.operation, most_bytes=text_bytes)
        if len(grant.limits) > parameters:
            raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {parameters} parameters")
        names = [limit.parameter.name for limit in grant.limits]
        if len(names) != len(set(names)):
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a parameter twice")
        for limit in grant.limits:
            text.name(limit.parameter.name, most_bytes=text_bytes)
            _check_bound(limit.parameter.kind, limit.bound, one_of, text_bytes)
        if grant.budgets:
            _check_budgets(grant.budgets, caps.budgets, text_bytes)


def _check_budgets(stated: tuple[Budget, ...], most: int, text_bytes: int) -> None:
    if len(stated) > most:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {most} budgets")
    for each in stated:
        if each.parameter:
            text.name(each.parameter, most_bytes=text_bytes)
        text.url(each.audience, most_bytes=text_bytes)
        _integer(each.window_s, 1, budgets.LONGEST_S, "per_s")
        _integer(each.most, 1, INT_LIMIT, "most")
    if stated != budgets.least(stated):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "budgets not sorted, or one that another implies")


def check_limit(limit: Limit, caps: Caps) -> None:
    """Checks that a limit is one of its kind, in its one form.

    Raises:
        ScopeError: it is not.
    """
    text.name(limit.parameter.name, most_bytes=caps.text_bytes)
    _check_bound(limit.parameter.kind, limit.bound, caps.one_of, caps.text_bytes)


def _check_bound(kind: Kind, bound: Bound, one_of: int, text_bytes: int) -> None:
    """Checks that a bound is one of this kind, in its one form."""
    if not _fits(kind, bound):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a bound of another kind than its parameter")
    match bound:
        case Range(low, high):
            _integer(low, -INT_LIMIT, INT_LIMIT, "low")
            _integer(high, low, INT_LIMIT, "high")
        case OneOf(values) | Flags(values) | Words(values) | Stems(values):
            if not 1 <= len(values) <= one_of:
                raise ScopeError(FaultCode.OUT_OF_RANGE, f"a set of none or more than {one_of} values")
            for value in values:
                _check_member(kind, bound, value, text_bytes)
            if canonical(bound) != bound:
                raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a set of values in another form than its one")
        case Each(element, least, most):
            _integer(least, 0, LIST_LENGTH, "least")
            _integer(most, least, LIST_LENGTH, "most")
            if element is not None and isinstance(kind, ListOf):
                _check_bound(kind.element, element, one_of, text_bytes)
            if canonical(bound) != bound:
                raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a bound of members where there are none")
        case _:
            assert_never(bound)


def _fits(kind: Kind, bound: Bound) -> bool:
    """True where a bound has the form of this kind's."""
    match kind:
        case Unit() | DeclaredUnit():
            return isinstance(bound, (Range, OneOf))
        case Sort.FREE:
            return isinstance(bound, Range) and bound.low == 1  # the size of any JSON value
        case Sort.FLAG:
            return isinstance(bound, Flags)
        case Sort.TEXT:
            return isinstance(bound, Words) or (isinstance(bound, Stems) and bound.divider == "")
        case Sort.PATH | Sort.URL:
            return isinstance(bound, Words) or (isinstance(bound, Stems) and bound.divider == "/")
        case ListOf():
            return isinstance(bound, Each)
        case _:
            assert_never(kind)


def _check_member(kind: Kind, bound: Bound, value: object, text_bytes: int) -> None:
    """Checks a member of a set, or a stem; the empty stem stands for all words, and for all paths."""
    match bound:
        case OneOf():
            _integer(value, -INT_LIMIT, INT_LIMIT, "value")
        case Flags():
            if not isinstance(value, bool):
                raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a truth value")
        case Stems() if value == "":
            return
        case Stems() if value == "/" and kind is Sort.PATH:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "all paths have the empty stem")
        case _:
            text.WORD[kind](value, most_bytes=text_bytes)


@functools.lru_cache(maxsize=REMEMBERED)  # likewise
def _check_names(audiences: frozenset[str], delegates: frozenset[str], most: int, text_bytes: int) -> None:
    if max(len(audiences), len(delegates)) > most:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {most} audiences or delegates")
    for audience in audiences:
        text.url(audience, most_bytes=text_bytes)
    for delegate in delegates:
        text.delegate(delegate, most_bytes=text_bytes)

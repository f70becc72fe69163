"""Scopes and restrictions on the wire: strict both ways, one spelling for each value."""

from __future__ import annotations

from typing import Any, Final

from msgspec import UNSET, UnsetType

from capabilities.values import budgets
from capabilities.values.bounds import limits_to_json
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.form import Form, FormError, read
from capabilities.values.scope import (
    Budget,
    Each,
    Flags,
    Grant,
    Limit,
    OneOf,
    Range,
    Restriction,
    ScalarBound,
    Scope,
    Stems,
    Tier,
    Words,
)
from capabilities.values.units import DeclaredUnit, Parameter, Unit, kind_of
from capabilities.values.well_formed import well_formed, well_formed_restriction

_UNSORTED: Final = "values not ascending, or one twice"
_DIMENSIONS: Final = ("grants", "ceiling", "audiences", "delegates", "depth", "not_before", "not_after")


def scope_to_json(scope: Scope) -> dict[str, object]:
    """The scope as plain JSON; every list in its one order."""
    return {dimension: _WRITE[dimension](getattr(scope, dimension)) for dimension in _DIMENSIONS}


def restriction_to_json(restriction: Restriction) -> dict[str, object]:
    """The restriction as plain JSON; a dimension that it keeps is absent."""
    stated = ((dimension, getattr(restriction, dimension)) for dimension in _DIMENSIONS)
    return {dimension: _WRITE[dimension](value) for dimension, value in stated if value is not None}


def scope_from_json(obj: object) -> Scope:
    """The scope of a plain JSON value in the very form that `scope_to_json` writes.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` for a missing, unknown, mistyped or unsorted member, `OUT_OF_RANGE` for a
            number.
    """
    members = _members(obj)
    if members.keys() != set(_DIMENSIONS):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a scope has exactly its seven members")
    return well_formed(Scope(**_read(members)), DEFAULT)


def restriction_from_json(obj: object) -> Restriction:
    """The restriction of a plain JSON value in the very form that `restriction_to_json` writes.

    Raises:
        ScopeError: as `scope_from_json`.
    """
    members = _members(obj)
    if not members.keys() <= set(_DIMENSIONS):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a restriction has no other members")
    return well_formed_restriction(Restriction(**_read(members)), DEFAULT)


# --- writing ---------------------------------------------------------------------------------------------------------


def _write_grants(grants: tuple[Grant, ...]) -> list[object]:
    return [
        {
            "object": grant.object,
            "operation": grant.operation,
            "limits": limits_to_json(grant.limits),
            **({"budgets": budgets.to_json(grant.budgets)} if grant.budgets else {}),
        }
        for grant in grants
    ]


_WRITE: Final[dict[str, Any]] = {
    "grants": _write_grants,
    "ceiling": int,
    "audiences": sorted,
    "delegates": sorted,
    "depth": int,
    "not_before": int,
    "not_after": int,
}


# --- reading ---------------------------------------------------------------------------------------------------------


class _ScalarBound(Form, frozen=True, kw_only=True):
    """Members of a bound of one value."""

    one_of: tuple[int | bool | str, ...] | UnsetType = UNSET
    low: int | UnsetType = UNSET
    high: int | UnsetType = UNSET
    starts_with: tuple[str, ...] | UnsetType = UNSET
    under: tuple[str, ...] | UnsetType = UNSET


class _Limit(_ScalarBound, frozen=True, kw_only=True):
    parameter: str
    unit: str | UnsetType = UNSET
    kind: str | UnsetType = UNSET
    each: _ScalarBound | UnsetType | None = UNSET
    least: int | UnsetType = UNSET
    most: int | UnsetType = UNSET


class _Budget(Form, frozen=True, kw_only=True):
    parameter: str | UnsetType = UNSET
    audience: str
    most: int
    per_s: int


class _Grant(Form, frozen=True):
    object: str
    operation: str
    limits: tuple[_Limit, ...]
    budgets: tuple[_Budget, ...] | UnsetType = UNSET


_FORMS: Final[dict[str, Any]] = {
    "grants": tuple[_Grant, ...],
    "ceiling": int,
    "audiences": tuple[str, ...],
    "delegates": tuple[str, ...],
    "depth": int,
    "not_before": int,
    "not_after": int,
}


def _members(value: object) -> dict[str, object]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not an object")
    return value


def _read(members: dict[str, object]) -> dict[str, Any]:
    return {dimension: _dimension(dimension, value) for dimension, value in members.items()}


def _dimension(dimension: str, value: object) -> Any:
    try:
        stated = read(_FORMS[dimension], value)
    except FormError as error:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, f"{dimension}: {error}") from None
    match dimension:
        case "grants":
            return tuple(
                Grant(each.object, each.operation, tuple(map(_limit, each.limits)), _budgets(each.budgets))
                for each in stated
            )
        case "ceiling" if not 0 <= stated <= max(Tier):
            raise ScopeError(FaultCode.OUT_OF_RANGE, "no such tier")
        case "ceiling":
            return Tier(stated)
        case "audiences" | "delegates":
            return _set(stated, "names not sorted, or one twice")
        case _:
            return stated


def _budgets(stated: tuple[_Budget, ...] | UnsetType) -> tuple[Budget, ...]:
    """Budgets of a grant; their order and form are checked with the rest of it."""
    if isinstance(stated, UnsetType):
        return ()
    if not stated or any(each.parameter == "" for each in stated):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "no budgets are no member, and so is no parameter")
    return tuple(
        Budget("" if isinstance(each.parameter, UnsetType) else each.parameter, each.audience, each.per_s, each.most)
        for each in stated
    )


def _limit(stated: _Limit) -> Limit:
    match stated.unit, stated.kind:
        case str(spelled), UnsetType():
            kind = kind_of(spelled)
            named = isinstance(kind, (Unit, DeclaredUnit))
        case UnsetType(), str(spelled):
            kind = kind_of(spelled)
            named = not isinstance(kind, (Unit, DeclaredUnit))
        case _:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not exactly one of unit and kind")
    if not named:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a unit for a kind, or a kind for a unit")
    parameter = Parameter(stated.parameter, kind)
    lists = stated.each, stated.least, stated.most
    match lists:
        case UnsetType(), UnsetType(), UnsetType():
            return Limit(parameter, _bound(stated))
        case element, int(least), int(most) if not isinstance(element, UnsetType) and _empty(stated):
            return Limit(parameter, Each(None if element is None else _bound(element), least, most))
        case _:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not exactly each, least and most")


def _empty(stated: _ScalarBound) -> bool:
    """True where no bound of one value is stated."""
    members = stated.one_of, stated.low, stated.high, stated.starts_with, stated.under
    return all(isinstance(member, UnsetType) for member in members)


def _bound(stated: _ScalarBound) -> ScalarBound:
    match stated.one_of, stated.low, stated.high, stated.starts_with, stated.under:
        case tuple(values), UnsetType(), UnsetType(), UnsetType(), UnsetType():
            return _finite(values)
        case UnsetType(), int(low), int(high), UnsetType(), UnsetType():
            return Range(low, high)
        case UnsetType(), UnsetType(), UnsetType(), tuple(stems), UnsetType():
            return Stems(_set(stems, _UNSORTED), "")
        case UnsetType(), UnsetType(), UnsetType(), UnsetType(), tuple(stems):
            return Stems(_set(stems, _UNSORTED), "/")
        case _:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not exactly one form of bound")


def _finite(values: tuple[Any, ...]) -> ScalarBound:
    """The set of these members, which are of one type."""
    types = set(map(type, values))
    if types == {bool}:
        return Flags(_set(values, _UNSORTED))
    if types == {str}:
        return Words(_set(values, _UNSORTED))
    if types <= {int}:
        return OneOf(_set(values, _UNSORTED))
    raise ScopeError(FaultCode.STATEMENT_MALFORMED, "members of different types")


def _set(stated: tuple[Any, ...], wrong: str) -> frozenset[Any]:
    """The members, when each is there once and in order."""
    if list(stated) != sorted(set(stated)):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, wrong)
    return frozenset(stated)

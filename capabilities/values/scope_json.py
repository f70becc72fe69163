"""Scopes and restrictions on the wire: strict both ways, one spelling for each value."""

from __future__ import annotations

from typing import Any, Final

from capabilities.values.bounds import limits_to_json
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.scope import Bound, Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Unit
from capabilities.values.well_formed import well_formed, well_formed_restriction

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


def _read(members: dict[str, object]) -> dict[str, Any]:
    return {dimension: _READ[dimension](value) for dimension, value in members.items()}


def _members(value: object) -> dict[str, object]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not an object")
    return value


def _exactly(value: object, *names: str) -> tuple[object, ...]:
    members = _members(value)
    if members.keys() != set(names):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, f"not exactly {', '.join(names)}")
    return tuple(members[name] for name in names)


def _integer(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not an integer")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a text")
    return value


def _list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a list")
    return value


def _names(value: object) -> frozenset[str]:
    names = [_text(member) for member in _list(value)]
    if names != sorted(set(names)):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "names not sorted, or one twice")
    return frozenset(names)


def _tier(value: object) -> Tier:
    if not 0 <= _integer(value) <= max(Tier):
        raise ScopeError(FaultCode.OUT_OF_RANGE, "no such tier")
    return Tier(_integer(value))


def _grants(value: object) -> tuple[Grant, ...]:
    return tuple(map(_grant, _list(value)))


def _grant(value: object) -> Grant:
    thing, operation, limits = _exactly(value, "object", "operation", "limits")
    return Grant(_text(thing), _text(operation), tuple(map(_limit, _list(limits))))


def _limit(value: object) -> Limit:
    bound: Bound
    if "one_of" in _members(value):
        name, unit, one_of = _exactly(value, "parameter", "unit", "one_of")
        values = [_integer(member) for member in _list(one_of)]
        if values != sorted(set(values)):
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "values not ascending, or one twice")
        bound = OneOf(frozenset(values))
    else:
        name, unit, low, high = _exactly(value, "parameter", "unit", "low", "high")
        bound = Range(_integer(low), _integer(high))
    try:
        return Limit(Parameter(_text(name), Unit(_text(unit))), bound)
    except ValueError:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "no such unit") from None


_READ: Final[dict[str, Any]] = {
    "grants": _grants,
    "ceiling": _tier,
    "audiences": _names,
    "delegates": _names,
    "depth": _integer,
    "not_before": _integer,
    "not_after": _integer,
}

"""The partial order *narrows* on scopes, and its meet.

`meet` is the intersection of two bounds. `stated` lays a restriction over its parent as it was written, `narrows` finds
every place where a child has more than its parent and every dimension in which it has strictly less, and `apply` gives
the scope that holds afterwards. For a restriction that `narrows` finds nowhere wider, `apply` and `stated` are the same
scope; a test says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from capabilities import text
from capabilities.errors import FaultCode, ScopeError
from capabilities.scope import Bound, Grant, Limit, OneOf, Range, Restriction, Scope, Tier, Widening
from capabilities.units import INT_LIMIT

if TYPE_CHECKING:
    from capabilities.caps import Caps

TIME_LIMIT: Final = 253_402_300_800
"""First second of the year 10000: no time in a token reaches it."""


@dataclass(frozen=True, slots=True)
class Narrowing:
    """How a child scope compares with its parent.

    Attributes:
        widenings: every place where the child has more. Empty when the child narrows the parent.
        strict: the dimensions in which the child has strictly less, out of "grants", "limits", "ceiling", "audiences",
            "delegates". Depth and time shrink at every hop anyway and do not count.
    """

    widenings: tuple[Widening, ...]
    strict: frozenset[str]


# --- bounds ----------------------------------------------------------------------------------------------------------


def permits(bound: Bound, value: int) -> bool:
    """True exactly for the integers inside `bound`."""
    match bound:
        case Range(low, high):
            return low <= value <= high
        case OneOf(values):
            return value in values
        case _:
            assert_never(bound)


def size(bound: Bound) -> int:
    """How many integers are inside."""
    match bound:
        case Range(low, high):
            return max(0, high - low + 1)
        case OneOf(values):
            return len(values)
        case _:
            assert_never(bound)


def meet(a: Bound, b: Bound) -> Bound | None:
    """The integers inside both, or None when there is none. Commutative, associative and idempotent."""
    if isinstance(a, OneOf):
        return _some(a.values, b)
    if isinstance(b, OneOf):
        return _some(b.values, a)
    low, high = max(a.low, b.low), min(a.high, b.high)
    return Range(low, high) if low <= high else None


def _some(values: frozenset[int], bound: Bound) -> OneOf | None:
    kept = frozenset(value for value in values if permits(bound, value))
    return OneOf(kept) if kept else None


def within(child: Bound, parent: Bound) -> bool:
    """True when every integer inside `child` is inside `parent`."""
    match child:
        case OneOf(values):
            return all(permits(parent, value) for value in values)
        case Range(low, high):
            match parent:
                case Range():
                    return parent.low <= low and high <= parent.high
                case OneOf(values):
                    # Counting first keeps a wide range from being walked.
                    return size(child) <= len(values) and all(value in values for value in range(low, high + 1))


def nearest(bound: Bound, value: int) -> int:
    """The integer inside `bound` that is nearest to `value`; the lower one of two equally near."""
    match bound:
        case Range(low, high):
            return min(max(value, low), high)
        case OneOf(values):
            return min(values, key=lambda member: (abs(member - value), member))
        case _:
            assert_never(bound)


def bound_to_json(bound: Bound) -> dict[str, object]:
    """The bound as plain JSON: ``{"low", "high"}`` or ``{"one_of"}`` in ascending order."""
    match bound:
        case Range(low, high):
            return {"low": low, "high": high}
        case OneOf(values):
            return {"one_of": sorted(values)}
        case _:
            assert_never(bound)


# --- well-formed scopes ----------------------------------------------------------------------------------------------


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
    _check_names(scope.audiences, scope.delegates, caps)
    _integer(scope.ceiling, 0, max(Tier), "ceiling")
    _integer(scope.depth, 0, caps.hops, "depth")
    _integer(scope.not_before, 0, TIME_LIMIT, "not_before")
    _integer(scope.not_after, scope.not_before + 1, TIME_LIMIT, "not_after")
    return scope


def well_formed_restriction(restriction: Restriction, caps: Caps) -> Restriction:
    """The restriction itself, when each dimension that it states keeps the rules of the profile.

    Raises:
        ScopeError: as `well_formed`.
    """
    if restriction.grants is not None:
        if not restriction.grants:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a restriction to no grant at all")
        _check_grants(restriction.grants, caps)
    if restriction.audiences is not None and not restriction.audiences:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a restriction to no audience at all")
    _check_names(restriction.audiences or frozenset(), restriction.delegates or frozenset(), caps)
    for value, most, what in (
        (restriction.ceiling, int(max(Tier)), "ceiling"),
        (restriction.depth, caps.hops, "depth"),
        (restriction.not_before, TIME_LIMIT, "not_before"),
        (restriction.not_after, TIME_LIMIT, "not_after"),
    ):
        if value is not None:
            _integer(value, 0, most, what)
    return restriction


def _integer(value: object, low: int, high: int, what: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"{what} outside {low}..{high}")


def _check_grants(grants: tuple[Grant, ...], caps: Caps) -> None:
    if len(grants) > caps.grants:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {caps.grants} grants")
    pairs = [(grant.object, grant.operation) for grant in grants]
    if pairs != sorted(set(pairs)):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "grants not sorted by object and operation, or one twice")
    for grant in grants:
        text.name(grant.object, most_bytes=caps.text_bytes)
        text.name(grant.operation, most_bytes=caps.text_bytes)
        if len(grant.limits) > caps.parameters:
            raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {caps.parameters} parameters")
        names = [limit.parameter.name for limit in grant.limits]
        if len(names) != len(set(names)):
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a parameter twice")
        for limit in grant.limits:
            text.name(limit.parameter.name, most_bytes=caps.text_bytes)
            _check_bound(limit.bound, caps)


def _check_bound(bound: Bound, caps: Caps) -> None:
    match bound:
        case Range(low, high):
            _integer(low, -INT_LIMIT, INT_LIMIT, "low")
            _integer(high, low, INT_LIMIT, "high")
        case OneOf(values):
            if not 1 <= len(values) <= caps.one_of:
                raise ScopeError(FaultCode.OUT_OF_RANGE, f"a set of none or more than {caps.one_of} values")
            for value in values:
                _integer(value, -INT_LIMIT, INT_LIMIT, "value")
        case _:
            assert_never(bound)


def _check_names(audiences: frozenset[str], delegates: frozenset[str], caps: Caps) -> None:
    if max(len(audiences), len(delegates)) > caps.one_of:
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"more than {caps.one_of} audiences or delegates")
    for audience in audiences:
        text.url(audience, most_bytes=caps.text_bytes)
    for delegate in delegates:
        text.delegate(delegate, most_bytes=caps.text_bytes)


# --- restricting -----------------------------------------------------------------------------------------------------


def stated(parent: Scope, restriction: Restriction) -> Scope:
    """The child as the restriction states it, wider places included.

    What the restriction leaves out is the parent's, with one hop less of depth.
    """
    grants = parent.grants
    if restriction.grants is not None:
        known = {(grant.object, grant.operation): grant for grant in parent.grants}
        grants = tuple(_lay_over(known.get((grant.object, grant.operation)), grant) for grant in restriction.grants)
    return Scope(
        grants=grants,
        ceiling=parent.ceiling if restriction.ceiling is None else restriction.ceiling,
        audiences=parent.audiences if restriction.audiences is None else restriction.audiences,
        delegates=parent.delegates if restriction.delegates is None else restriction.delegates,
        depth=parent.depth - 1 if restriction.depth is None else restriction.depth,
        not_before=parent.not_before if restriction.not_before is None else restriction.not_before,
        not_after=parent.not_after if restriction.not_after is None else restriction.not_after,
    )


def _lay_over(parent: Grant | None, child: Grant) -> Grant:
    """The parent's signature with the child's bounds; limits of parameters that the parent does not know come last."""
    if parent is None:
        return child
    tightened = {limit.parameter: limit for limit in child.limits}
    kept = tuple(tightened.pop(limit.parameter, limit) for limit in parent.limits)
    return Grant(parent.object, parent.operation, (*kept, *tightened.values()))


def narrows(child: Scope, parent: Scope) -> Narrowing:
    """Every place where `child` has more than `parent`, and the dimensions in which it has strictly less."""
    widenings: list[Widening] = []
    strict: set[str] = set()

    known = {(grant.object, grant.operation): grant for grant in parent.grants}
    for grant in child.grants:
        above = known.get((grant.object, grant.operation))
        if above is None:
            widenings.append(
                Widening("grants", f"{grant.object}/{grant.operation}", None, [_limit_to_json(x) for x in grant.limits])
            )
        else:
            _compare_limits(grant, above, widenings, strict)
    if len(child.grants) < len(parent.grants):
        strict.add("grants")

    if child.ceiling > parent.ceiling:
        widenings.append(Widening("ceiling", "ceiling", int(parent.ceiling), int(child.ceiling)))
    elif child.ceiling < parent.ceiling:
        strict.add("ceiling")
    _compare_sets("audiences", child.audiences, parent.audiences, widenings, strict)
    _compare_sets("delegates", child.delegates, parent.delegates, widenings, strict)
    if child.depth > parent.depth:
        widenings.append(Widening("depth", "depth", parent.depth, child.depth))
    if child.not_before < parent.not_before or child.not_after > parent.not_after:
        above_window, below_window = [parent.not_before, parent.not_after], [child.not_before, child.not_after]
        widenings.append(Widening("window", "window", above_window, below_window))
    return Narrowing(tuple(widenings), frozenset(strict))


def _limit_to_json(limit: Limit) -> dict[str, object]:
    return {"parameter": limit.parameter.name, "unit": str(limit.parameter.unit), **bound_to_json(limit.bound)}


def _compare_limits(child: Grant, parent: Grant, widenings: list[Widening], strict: set[str]) -> None:
    where = f"{child.object}/{child.operation}"
    if [limit.parameter for limit in child.limits] != [limit.parameter for limit in parent.limits]:
        # Another signature is another operation: neither parameters nor units nor their order may change.
        widenings.append(
            Widening(
                "limits", where, [_limit_to_json(x) for x in parent.limits], [_limit_to_json(x) for x in child.limits]
            )
        )
        return
    for below, above in zip(child.limits, parent.limits, strict=True):
        if not within(below.bound, above.bound):
            what = f"{where}/{below.parameter.name}"
            widenings.append(Widening("limits", what, bound_to_json(above.bound), bound_to_json(below.bound)))
        elif size(below.bound) < size(above.bound):
            strict.add("limits")


def _compare_sets(
    dimension: str, child: frozenset[str], parent: frozenset[str], widenings: list[Widening], strict: set[str]
) -> None:
    if not child <= parent:
        widenings.append(Widening(dimension, dimension, sorted(parent), sorted(child)))
    elif child < parent:
        strict.add(dimension)


def apply(parent: Scope, r: Restriction) -> Scope:
    """The scope that holds after a hop: the meet of the parent with what is stated, with one hop less of depth.

    Raises:
        ScopeError: `TOO_MANY_HOPS` when the parent may not be delegated further; `NOT_NARROWER` for a grant or
            parameter that the parent does not have, and for a restriction that leaves no grant, no audience, no time or
            no value of a parameter.
    """
    if parent.depth < 1:
        raise ScopeError(FaultCode.TOO_MANY_HOPS, "no depth is left")
    child = stated(parent, r)
    window = max(parent.not_before, child.not_before), min(parent.not_after, child.not_after)
    audiences = parent.audiences & child.audiences
    if not window[0] < window[1] or not audiences or not child.grants:
        raise ScopeError(FaultCode.NOT_NARROWER, "nothing is left")
    known = {(grant.object, grant.operation): grant for grant in parent.grants}
    return Scope(
        grants=tuple(_meet_grants(known.get((grant.object, grant.operation)), grant) for grant in child.grants),
        ceiling=min(parent.ceiling, child.ceiling),
        audiences=audiences,
        delegates=parent.delegates & child.delegates,
        depth=min(parent.depth - 1, child.depth),
        not_before=window[0],
        not_after=window[1],
    )


def _meet_grants(parent: Grant | None, child: Grant) -> Grant:
    if parent is None:
        raise ScopeError(FaultCode.NOT_NARROWER, f"{child.object}/{child.operation} is not granted")
    if [limit.parameter for limit in child.limits] != [limit.parameter for limit in parent.limits]:
        raise ScopeError(FaultCode.NOT_NARROWER, f"{child.object}/{child.operation} has other parameters")
    limits = []
    for below, above in zip(child.limits, parent.limits, strict=True):
        both = meet(below.bound, above.bound)
        if both is None:
            raise ScopeError(
                FaultCode.NOT_NARROWER, f"{child.object}/{child.operation}/{below.parameter.name}: nothing is left"
            )
        limits.append(Limit(below.parameter, both))
    return Grant(parent.object, parent.operation, tuple(limits))

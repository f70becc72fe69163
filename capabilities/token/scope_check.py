"""Check of a request against the compiled scope of a verified chain, and against Biscuit's own answer.

A refusal names the hop that set the bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, assert_never

from capabilities.token.biscuit import Answer, OpenedToken, Probe
from capabilities.values import algebra
from capabilities.values.arguments import is_of, measured
from capabilities.values.chain import Chain, Hop, Refusal
from capabilities.values.errors import Fault, FaultCode, TokenError
from capabilities.values.scope import Bound, Each, Flags, Grant, OneOf, Range, Scope, Stems, Tier, Words
from capabilities.values.units import Quantity, Sort

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capabilities.values.arguments import Value
    from capabilities.values.bounds import Measured
    from capabilities.values.caps import Caps

_NO_OPERATION: Final = "no operation has a name with spaces"
"""An operation that no scope can grant, since names hold no space."""


# --- step 11 ---------------------------------------------------------------------------------------------------------


def refusal(
    chain: Chain,
    *,
    object: str,  # noqa: A002 - the word of the profile
    operation: str,
    values: tuple[Value, ...],
    base_tier: Tier,
) -> Refusal | None:
    """Refusal of a request by the compiled scope, or None.

    Closed world: exactly the parameters of the grant, in its order, of its kinds, each canonical and inside its bound.
    """
    grant = chain.scope.find(object, operation)
    if grant is None:
        dropped_by = next((hop for hop in chain.hops if hop.scope.find(object, operation) is None), chain.leaf)
        return _refusal(chain, FaultCode.NOT_GRANTED, dropped_by)
    if len(values) != len(grant.limits):
        return _refusal(chain, FaultCode.PARAMETERS_WRONG, chain.hops[0])
    for value, limit in zip(values, grant.limits, strict=True):
        named = limit.parameter
        # A quantity in a unit of the profile, which most are, is seen to be one without a call.
        usual = type(value) is Quantity and value.unit is named.kind and type(value.value) is int
        if value.name != named.name or not (usual or is_of(named.kind, value)):
            return _refusal(chain, FaultCode.PARAMETERS_WRONG, chain.hops[0])
    for value, limit in zip(values, grant.limits, strict=True):
        given = value.value if type(value) is Quantity else measured(value)
        if not algebra.permits(limit.bound, given):
            bound, hop = tightest(chain, object, operation, value.name, value=given)
            return Refusal(
                code=FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
                parameter=value.name,
                value=given,
                unit=limit.parameter.kind,
                bound=bound,
                nearest=None if limit.parameter.kind is Sort.FREE else algebra.nearest(bound, given),
                hop=hop.index,
                hop_id=hop.hop_id,
                agent=hop.agent,
                sponsor=chain.sponsor.subject,
            )
    if not base_tier <= chain.scope.ceiling:
        return _refusal(chain, FaultCode.ABOVE_CEILING, set_ceiling(chain))
    return None


def tightest(
    chain: Chain,
    object: str,  # noqa: A002 - the word of the profile
    operation: str,
    parameter: str,
    *,
    value: Measured | None = None,
) -> tuple[Bound, Hop]:
    """The bound that holds for a parameter, and the hop that set it.

    Args:
        chain: a verified chain.
        object: of a granted pair.
        operation: of a granted pair.
        parameter: its name.
        value: when given, and the bound is a range, the hop is the one that set the side on which the value lies.

    Raises:
        KeyError: when the leaf grants no such parameter.
    """
    bounds = []
    for hop in chain.hops:
        grant = hop.scope.find(object, operation)
        limits = () if grant is None else grant.limits
        bounds.append(next((limit.bound for limit in limits if limit.parameter.name == parameter), None))
    held = bounds[-1]
    if held is None:
        raise KeyError(parameter)
    side = _side(held, held, value)
    # The setter is the first hop from which this side holds without a change.
    index = len(bounds) - 1
    while index and (above := bounds[index - 1]) is not None and _side(above, held, value) == side:
        index -= 1
    return held, chain.hops[index]


def _side(bound: Bound, held: Bound, value: Any) -> object:
    """Part of `bound` that stands against `value`: one end of a range, or the whole bound."""
    match bound, held:
        case Range(low, high), Range() if value is not None and not algebra.permits(held, value):
            return low if value < held.low else high
        case _:
            return bound


def set_ceiling(chain: Chain) -> Hop:
    """The hop that set the tier ceiling which holds."""
    return next(hop for hop in chain.hops if hop.scope.ceiling == chain.scope.ceiling)


def _refusal(chain: Chain, code: FaultCode, hop: Hop) -> Refusal:
    return Refusal(code=code, hop=hop.index, hop_id=hop.hop_id, agent=hop.agent, sponsor=chain.sponsor.subject)


# --- step 12 ---------------------------------------------------------------------------------------------------------


def disagreement(opened: OpenedToken, scope: Scope, grant: Grant, caps: Caps) -> Fault | None:
    """None when Biscuit's authorizer draws the lines of `grant` where the compiled scope does; the fault otherwise.

    Every corner just inside must be allowed; every point just outside, along each parameter, time, tier, arity and
    operation, refused.
    """
    for expected, probes in ((Answer.ALLOWED, inside(scope, grant)), (Answer.REFUSED, outside(scope, grant))):
        for probe in probes:
            try:
                answer = opened.decide(probe, caps)
            except TokenError as error:
                return Fault(error.code, "TOK-12", error.detail)
            if answer is not expected:
                return Fault(
                    FaultCode.ENGINES_DISAGREE, "TOK-12", f"{answer.value} where the scope says {expected.value}"
                )
    return None


def inside(scope: Scope, grant: Grant) -> Iterator[Probe]:
    """The lowest and the highest corner, and every member of every finite set once."""
    members = [_members(limit.bound) for limit in grant.limits]
    steps = max([2, *map(len, members)])
    for step in range(steps):
        values = tuple(some[min(step, len(some) - 1)] for some in members)
        time = scope.not_before if step == 0 else scope.not_after - 1
        tier = 0 if step == 0 else int(scope.ceiling)
        yield Probe(grant.object, grant.operation, values, time, tier)


def outside(scope: Scope, grant: Grant) -> Iterator[Probe]:
    """One step over each line, everything else inside."""
    values = tuple(_members(limit.bound)[0] for limit in grant.limits)
    time, tier = scope.not_before, int(scope.ceiling)
    for i, limit in enumerate(grant.limits):
        for value in _just_outside(limit.bound):
            yield Probe(grant.object, grant.operation, (*values[:i], value, *values[i + 1 :]), time, tier)
    yield Probe(grant.object, grant.operation, values, scope.not_before - 1, tier)
    yield Probe(grant.object, grant.operation, values, scope.not_after, tier)
    yield Probe(grant.object, grant.operation, values, time, tier + 1)
    yield Probe(grant.object, grant.operation, (*values, 0), time, tier)
    if values:
        yield Probe(grant.object, grant.operation, values[:-1], time, tier)
    yield Probe(grant.object, _NO_OPERATION, values, time, tier)


def _members(bound: Bound) -> list[Any]:
    """Some values inside: each end, each member, and each stem with a word that goes on after it."""
    match bound:
        case Range(low, high):
            return [low, high]
        case OneOf(values) | Flags(values) | Words(values):
            return sorted(values)
        case Stems(values, divider):
            return [word for stem in sorted(values) for word in (stem, f"{stem}{divider}x")]
        case Each(element, least, most):
            members = [] if element is None else _members(element)
            some = [(member,) * max(least, 1) for member in members]
            return [(*members[:1],) * least, *some, (*members[-1:],) * most]
        case _:
            assert_never(bound)


def _just_outside(bound: Bound) -> Iterator[Any]:
    match bound:
        case Range(low, high):
            yield low - 1
            yield high + 1
        case OneOf(values):
            yield from sorted({near for value in values for near in (value - 1, value + 1)} - values)
        case Flags(values):
            yield from sorted({False, True} - values)
        case Words(values):
            yield from sorted({near for word in values for near in (word[:-1], f"{word}x", f"{word}/x")} - values)
        case Stems(values, divider):
            beside = {near for stem in values for near in _beside(stem, divider)}
            yield from sorted(near for near in beside if not algebra.permits(bound, near))
        case Each(element, least, most):
            member = 0 if element is None else _members(element)[0]
            if least > 0:
                yield (member,) * (least - 1)
            yield (member,) * (most + 1)
            for wrong in () if element is None else _just_outside(element):
                yield (*(member,) * (max(least, 1) - 1), wrong)
        case _:
            assert_never(bound)


def _beside(stem: str, divider: str) -> Iterator[str]:
    """Words beside a stem: a character less, another last one, and one more where a divider has to follow."""
    if stem:
        yield stem[:-1]
        yield stem[:-1] + chr(ord(stem[-1]) ^ 1)
        yield stem + "x" if divider else stem[:-1]

"""Two engines, random chains: Biscuit's authorizer and the compiled scope never part, and no child permits more than its parent."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.token.biscuit import Answer, Probe
from capabilities.token.scope_check import disagreement
from capabilities.values.bounds import one_of
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import CapabilityError, FaultCode
from capabilities.values.scope import Grant, Limit, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Unit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.capabilities.world import CELL, NOW, OTHER_CELL, Forge, add_hop, check, mint_root, raw_of

from capabilities.token import biscuit
from capabilities.values import algebra

pytestmark = pytest.mark.clause("TOK-12")

PARAMETERS = tuple(Parameter(f"p{i}", Unit.COUNT) for i in range(3))
ARITY = {"a": 0, "b": 1, "c": 3}
AGENTS = ("robotic", "vision", "gripper")
numbers = st.integers(-6, 6)
bounds = st.tuples(numbers, numbers).map(lambda ends: Range(min(ends), max(ends))) | st.frozensets(
    numbers, min_size=1, max_size=4
).map(lambda values: one_of(*values))


def inner(bound):
    """A bound inside `bound`."""
    values = sorted(value for value in range(-7, 8) if algebra.permits(bound, value))
    return st.one_of(
        st.just(bound),
        st.frozensets(st.sampled_from(values), min_size=1).map(lambda some: one_of(*some)),
        st.tuples(st.sampled_from(values), st.sampled_from(values))
        .map(lambda ends: Range(min(ends), max(ends)))
        .filter(lambda child: algebra.within(child, bound)),
    )


@st.composite
def first_scopes(draw):
    grants = tuple(
        Grant("arm", name, tuple(Limit(PARAMETERS[i], draw(bounds)) for i in range(arity)))
        for name, arity in ARITY.items()
    )
    return Scope(
        grants, Tier(draw(st.integers(0, 3))), frozenset({CELL, OTHER_CELL}), frozenset(AGENTS), 8, NOW - 9, NOW + 900
    )


@st.composite
def narrower(draw, parent: Scope):
    kept = [grant for grant in parent.grants if draw(st.integers(0, 3))] or [parent.grants[0]]
    grants = tuple(
        Grant(
            g.object,
            g.operation,
            tuple(Limit(x.parameter, draw(inner(x.bound))) for x in g.limits if draw(st.booleans())),
        )
        for g in kept
    )
    return Restriction(
        grants=grants if draw(st.integers(0, 3)) else None,
        ceiling=Tier(draw(st.integers(0, parent.ceiling))) if draw(st.booleans()) else None,
        delegates=frozenset(sorted(parent.delegates)[1:]) if parent.delegates else None,
        not_after=parent.not_after - draw(st.integers(0, 5)) if draw(st.booleans()) else None,
    )


def compiled(scope: Scope, probe: Probe) -> Answer:
    grant = next((grant for grant in scope.grants if grant.operation == probe.operation), None)
    inside = (
        grant is not None
        and len(grant.limits) == len(probe.values)
        and all(algebra.permits(limit.bound, value) for limit, value in zip(grant.limits, probe.values, strict=True))
        and probe.base_tier <= scope.ceiling
        and scope.not_before <= probe.time < scope.not_after
    )
    return Answer.ALLOWED if inside else Answer.REFUSED


@pytest.mark.long
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(first_scopes(), st.data())
def test_engines_and_generations_agree(scope, data):
    token = mint_root(scope)
    family = [token]
    for agent in sorted(AGENTS):
        parent = check(family[-1])
        assert isinstance(parent, Chain)
        try:
            family.append(add_hop(family[-1], agent, data.draw(narrower(parent.scope))))
        except CapabilityError as error:
            assert error.code in {FaultCode.NOT_NARROWER, FaultCode.DELEGATE_NOT_ALLOWED}
            break
    chains = [check(token) for token in family]
    opened = [biscuit.open_token(token, raw_of("root")) for token in family]
    for chain, token in zip(chains, opened, strict=True):
        for grant in chain.scope.grants:
            assert disagreement(token, chain.scope, grant, DEFAULT) is None
    for _ in range(6):
        operation = data.draw(st.sampled_from(sorted(ARITY)))
        values = tuple(
            data.draw(st.integers(-8, 8)) for _ in range(data.draw(st.sampled_from([ARITY[operation]] * 5 + [0, 4])))
        )
        time = data.draw(st.sampled_from([NOW - 10, NOW - 9, NOW, NOW + 894, NOW + 899, NOW + 900]))
        probe = Probe("arm", operation, values, time, data.draw(st.integers(0, 4)))
        answers = [compiled(chain.scope, probe) for chain in chains]
        assert [token.decide(probe, DEFAULT) for token in opened] == answers
        allowed = [answer is Answer.ALLOWED for answer in answers]
        assert allowed == sorted(allowed, reverse=True)  # once refused, refused for every descendant


@pytest.mark.clause("TOK-6.8")
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(first_scopes(), first_scopes())
def test_no_forged_hop_that_is_wider_verifies(scope, other):
    """A hop block with arbitrary grants, signed by the real attester: it verifies only when it narrows."""
    parent = replace(scope, ceiling=Tier.HIGH_CONSEQUENCE)
    restriction = Restriction(grants=other.grants, ceiling=other.ceiling, delegates=frozenset())
    found = check(Forge.hop(mint_root(parent), restriction, parent=parent))
    wider = algebra.narrows(algebra.stated(parent, restriction), parent).widenings
    if wider:
        assert found.code is FaultCode.NOT_NARROWER
    else:
        assert isinstance(found, Chain)

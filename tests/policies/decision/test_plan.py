"""A set remembers of an operation the plan that it would make again, and it never grows without bound."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from policies.decision.policy import PLANS, Concern
from tests.model import triples
from tests.policies import world

from policies import Effect, Point, Request, decide, load_shipped, requirement


def test_a_remembered_plan_is_what_the_set_says_of_the_request():
    pick = random.Random(5).choice
    for _ in range(300):
        request, _, policies = triples.triple(pick)
        for _ in range(2):
            plan = policies.plan(request)
            assert plan.policies == tuple(p for p in policies.policies if p.concerns(request) is Concern.YES)
            assert plan.needs is requirement(request, policies)
            assert plan.needs.physical == (not plan.policies or any(p.pit_bound is not None for p in plan.policies))
            permits = [p for p in plan.policies if p.effect is Effect.PERMIT]
            assert plan.obligations == frozenset().union(*(p.obligations for p in permits))


@pytest.mark.parametrize("name", ["points", "object", "operation"])
def test_whatever_a_plan_rests_on_is_part_of_what_it_is_remembered_by(name):
    policies = load_shipped("paper-default")
    request, _ = world.asked()
    other = {"points": frozenset({Point.TOOL}), "object": "another", "operation": "read_state"}[name]
    changed = Request(**{f: getattr(request, f) for f in Request.__slots__} | {name: other})
    assert policies.plan(request) is not policies.plan(changed)
    assert policies.plan(request) is policies.plan(request)


def test_strangers_who_name_operations_fill_no_memory():
    policies = load_shipped("paper-default")
    request, evidence = world.asked()
    for n in range(3 * PLANS):
        named = Request(**{f: getattr(request, f) for f in Request.__slots__} | {"operation": f"made_up_{n}"})
        decide(named, evidence, policies)
        assert len(policies._plans) <= PLANS
    assert decide(request, evidence, policies).effect is Effect.PERMIT


def test_the_memory_is_no_part_of_a_set():
    one, other = load_shipped("paper-default"), load_shipped("paper-default")
    request, evidence = world.asked()
    decide(request, evidence, one)
    assert one == other
    assert one.digest == other.digest
    assert "_plans" not in repr(one)


@given(st.sampled_from([None, [], {}, 7, object()]))
def test_a_request_that_nothing_can_be_remembered_by_is_denied(strange):
    request, evidence = world.asked()
    policies = load_shipped("paper-default")
    for name in ("points", "object", "operation"):
        odd = Request(**{f: getattr(request, f) for f in Request.__slots__} | {name: strange})
        assert decide(odd, evidence, policies).effect is Effect.DENY

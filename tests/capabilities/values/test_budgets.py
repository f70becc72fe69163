"""Budgets: their order is that of courses of acts, their meet the widest below both, their form one."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
import z3
from capabilities.token.verify import Verifier
from capabilities.values import algebra, budgets
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.explanation import explain, repair
from capabilities.values.scope import Budget, Grant, Limit, Range, Restriction
from capabilities.values.scope_json import restriction_from_json, restriction_to_json, scope_from_json, scope_to_json
from capabilities.values.units import Parameter, Unit
from evaluation.tokens.campaigns.families import AGENTS
from evaluation.tokens.campaigns.issuer import CELLS, SPONSOR, Issuer, chain_of
from evaluation.tokens.campaigns.shapes import SMALL
from hypothesis import given
from hypothesis import strategies as st

pytestmark = pytest.mark.clause("VAL-20")

HERE, THERE = CELLS[:2]
ITEMS = Parameter("items", Unit.COUNT)
GO = Grant("arm", "go", (Limit(ITEMS, Range(0, 9)), Limit(Parameter("shift", Unit.COUNT), Range(-1, 9))))


def acts(most, per_s, audience=HERE, *, of=""):
    return Budget(of, audience, per_s, most)


def scope(*some, **other):
    return replace(SMALL, grants=(replace(GO, budgets=some),), audiences=frozenset({HERE}), **{"depth": 1, **other})


# --- the order -------------------------------------------------------------------------------------------------------


def inside(course, budget):
    """True where no window has more acts than the budget: by looking at every window of whole seconds."""
    return all(sum(course[at : at + budget.window_s]) <= budget.most for at in range(len(course)))


COURSES = list(itertools.product((0, 1, 2), repeat=6))
SMALL_BUDGETS = [acts(most, per_s) for most, per_s in itertools.product(range(1, 5), range(1, 5))]
OF_EACH = {each: {course for course in COURSES if inside(course, each)} for each in SMALL_BUDGETS}


def test_one_budget_implies_another_exactly_when_its_courses_are_among_the_others():
    for tight, loose in itertools.product(SMALL_BUDGETS, repeat=2):
        implied = budgets.implies(tight, loose)
        if implied:
            assert OF_EACH[tight] <= OF_EACH[loose], (tight, loose)
        elif tight.most <= 2:  # the courses here have at most two acts in a second
            assert not OF_EACH[tight] <= OF_EACH[loose], (tight, loose)


some = st.lists(
    st.builds(
        Budget, st.sampled_from(["", "items"]), st.sampled_from([HERE, THERE]), st.integers(1, 9), st.integers(1, 9)
    ),
    max_size=4,
).map(budgets.least)


@given(some, some, some)
def test_budgets_narrow_in_an_order_and_meet_in_the_widest(a, b, c):
    both = budgets.meet(a, b)
    assert both == budgets.meet(b, a)
    assert budgets.meet(a, a) == a == budgets.least(a)
    assert budgets.meet(both, c) == budgets.meet(a, budgets.meet(b, c))
    assert budgets.within(both, a)
    assert budgets.within(both, b)
    assert budgets.within(c, both) == (budgets.within(c, a) and budgets.within(c, b))
    assert (a == b) == (budgets.within(a, b) and budgets.within(b, a))
    assert not (budgets.within(a, b) and budgets.within(b, c)) or budgets.within(a, c)
    # What keeps the narrower budgets keeps the wider ones.
    if budgets.within(a, b):
        for course in COURSES[:: len(COURSES) // 20]:
            for at in {(each.parameter, each.audience) for each in b}:
                here = [[each for each in side if (each.parameter, each.audience) == at] for side in (a, b)]
                kept = [all(inside(course, each) for each in side) for side in here]
                assert kept[1] or not kept[0]


def test_implication_is_an_order_for_all_integers():
    """With z3: `k` is how many windows cover another; what transitivity needs of it is shown first."""
    m1, m2, m3, w1, w2, w3, k12, k23, k13, k21 = whole = z3.Ints("m1 m2 m3 w1 w2 w3 k12 k23 k13 k21")

    def covers(k, wide, narrow):
        return z3.And((k - 1) * narrow < wide, wide <= k * narrow)

    def holds(claim, *given_):
        solver = z3.Solver()
        solver.set("timeout", 10_000)
        solver.add(*(each >= 1 for each in whole), *given_, z3.Not(claim))
        return solver.check() == z3.unsat

    assert holds(z3.And(m1 == m2, w1 == w2), covers(k12, w2, w1), covers(k21, w1, w2), m1 * k12 <= m2, m2 * k21 <= m1)
    assert holds(w3 <= k23 * (k12 * w1), w2 <= k12 * w1, w3 <= k23 * w2)
    assert holds(k13 <= k23 * k12, (k13 - 1) * w1 < k23 * (k12 * w1))
    assert holds(m1 * k13 <= m3, k13 <= k23 * k12, m1 * k12 <= m2, m2 * k23 <= m3)
    assert not holds(m1 * k13 <= m3, m1 * k12 <= m2, m2 * k23 <= m3)


# --- hops ------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("VAL-11", "VAL-12")
def test_a_hop_keeps_what_it_does_not_state():
    parent = scope(acts(5, 60))
    child = algebra.hop(parent, Restriction(grants=(Grant("arm", "go", (Limit(ITEMS, Range(0, 3)),)),)))
    assert child.grants[0].budgets == parent.grants[0].budgets
    below = algebra.hop(parent, Restriction(grants=(Grant("arm", "go", (), (acts(4, 60),)),)))
    assert algebra.narrows(below, parent) == algebra.Narrowing((), frozenset({"budgets"}))
    assert below.grants[0].limits == parent.grants[0].limits


@pytest.mark.clause("VAL-16", "TOK-6.8")
def test_a_wider_budget_is_told_with_the_nearest():
    parent = scope(acts(5, 60))
    asked = Restriction(grants=(Grant("arm", "go", (), (acts(3, 20), acts(6, 60))),))
    told = explain(parent, asked)
    (place,) = told.widenings
    assert (place.dimension, place.what) == ("budgets", "arm/go")
    assert place.nearest == budgets.to_json((acts(3, 20), acts(5, 60)))
    assert told.repaired == Restriction(grants=(Grant("arm", "go", (), (acts(3, 20), acts(5, 60))),))
    assert f"at most 3 acts in 20 s at {HERE} and 6 acts in 60 s at {HERE} asked" in told.sentence
    assert repair(parent, Restriction(grants=(Grant("arm", "go", (), (acts(3, 20, of="other"),)),))) is None


# --- form ------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("VAL-13")
def test_a_scope_with_budgets_comes_back():
    stated = scope(acts(3, 20), acts(8, 60), acts(30, 60, of="items"))
    assert scope_from_json(scope_to_json(stated)) == stated
    less = Restriction(grants=(Grant("arm", "go", (), (acts(3, 20, of="items"),)),))
    assert restriction_from_json(restriction_to_json(less)) == less


ONE = {"audience": HERE, "most": 5, "per_s": 60}


@pytest.mark.clause("VAL-13")
@pytest.mark.parametrize(
    ("stated", "code"),
    [
        ([], FaultCode.STATEMENT_MALFORMED),
        ({}, FaultCode.STATEMENT_MALFORMED),
        ([ONE, ONE], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "per_s": 90}, ONE], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "most": 1, "per_s": 12}, ONE], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "parameter": ""}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "parameter": "shift"}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "parameter": "other"}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "audience": THERE}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "audience": "cell"}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "most": 5.0}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "most": "5"}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "more": 5}], FaultCode.STATEMENT_MALFORMED),
        ([{"audience": HERE, "most": 5}], FaultCode.STATEMENT_MALFORMED),
        ([{**ONE, "most": 0}], FaultCode.OUT_OF_RANGE),
        ([{**ONE, "per_s": 0}], FaultCode.OUT_OF_RANGE),
        ([{**ONE, "per_s": budgets.LONGEST_S + 1}], FaultCode.OUT_OF_RANGE),
        ([{**ONE, "most": n + 1, "per_s": n + 1} for n in range(65)], FaultCode.OUT_OF_RANGE),
    ],
)
def test_another_form_is_refused(stated, code):
    wire = scope_to_json(scope())
    wire["grants"][0]["budgets"] = stated
    with pytest.raises(ScopeError) as caught:
        scope_from_json(wire)
    assert caught.value.code is code


@pytest.mark.clause("VAL-20", "TOK-6.10", "BLK-13")
def test_what_is_issued_is_what_is_verified():
    issuer = Issuer("budgets")
    verifier = issuer.verifier()
    held = scope(acts(8, 60), acts(30, 60, of="items"), delegates=frozenset(AGENTS[1:]), depth=2)
    token = issuer.mint(held, issuer.holder(AGENTS[0], SPONSOR.subject))
    chain = chain_of(verifier, token)
    assert chain.scope == held
    less = Restriction(grants=(Grant("arm", "go", (), (acts(7, 60), acts(30, 60, of="items"))),))
    below = chain_of(verifier, issuer.delegate(token, chain, issuer.holder(AGENTS[1], AGENTS[0]), less))
    assert isinstance(below, Chain)
    assert below.scope.grants[0] == replace(held.grants[0], budgets=less.grants[0].budgets)
    strange = Restriction(grants=(Grant("arm", "go", (), (*less.grants[0].budgets, acts(1, 1, of="shift"))),))
    with pytest.raises(Exception, match="CHAIN_BROKEN"):
        issuer.delegate(token, chain, issuer.holder(AGENTS[1], AGENTS[0]), strange)
    assert isinstance(verifier, Verifier)
    assert DEFAULT.budgets == 64

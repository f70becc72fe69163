"""Proofs of the scope algebra, and the equality of their parts with the code, way by way."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
import z3
from capabilities.values import bounds
from capabilities.values.scope import OneOf, Range
from evaluation.tokens.campaigns import hop_laws, lattice, laws
from evaluation.tokens.campaigns.lattice import PROVEN, REFUTED, prove, symbolic_bound
from evaluation.tokens.campaigns.symbolic import Symbol, ways

pytestmark = pytest.mark.long

DOMAIN = range(-2, 3)
RANGES = [Range(low, high) for low in DOMAIN for high in DOMAIN if low <= high]
SETS = [OneOf(frozenset(values)) for values in product(DOMAIN, repeat=2) if values[0] + 1 < values[1]]


@pytest.mark.campaign
@pytest.mark.parametrize(
    "claim", (*lattice.BOUNDS, *lattice.WORDS, *lattice.SCOPES), ids=lambda claim: claim.law.__name__
)
def test_each_law_is_proven(claim):
    name, verdict, seconds = lattice.prove_one(claim)
    assert (name, verdict) == (claim.law.__name__, PROVEN)
    assert seconds > 0


@pytest.mark.campaign
@pytest.mark.parametrize("claim", lattice.BOUNDS, ids=lambda claim: claim.law.__name__)
def test_each_law_is_proven_of_ranges_and_pairs(claim):
    small = replace(claim, shapes=tuple(shape for shape in claim.shapes if max(shape) <= 2))
    assert len(small.shapes) == 2 ** len(claim.shapes[0])
    assert lattice.prove_one(small)[:2] == (claim.law.__name__, PROVEN)


STATED = {
    "limit": ("grants",),
    "ceiling": ("ceiling",),
    "depth": ("depth",),
    "window": ("not_before", "not_after"),
}
"""Members of a restriction that state something of each dimension."""


def one_dimension_at_a_time(claim, monkeypatch):
    """Cases of a law, with any numbers in one dimension of its operands, or of a narrower of any scope."""
    every, restriction = lattice._DIMENSIONS, lattice._fewer_numbers
    assert STATED.keys() == set(every)
    for dimension in every:
        if claim.restriction:
            others = {member: None for each in every if each != dimension for member in STATED[each]}
            monkeypatch.setattr(lattice, "_fewer_numbers", lambda run, o=others: replace(restriction(run), **o))
        else:
            monkeypatch.setattr(lattice, "_DIMENSIONS", (dimension,))
        numbers, *names = lattice.scope_cases(claim)
        yield numbers
    yield from names


@pytest.mark.campaign
@pytest.mark.parametrize("claim", lattice.SCOPES, ids=lambda claim: claim.law.__name__)
def test_each_law_is_proven_of_one_dimension_at_a_time(claim, monkeypatch):
    assert lattice.verdict(claim.law, one_dimension_at_a_time(claim, monkeypatch))[1] == PROVEN


def test_all_laws_are_told(monkeypatch):
    """No law of the two modules is left out, and `prove` tells each claim once, also one that is false."""
    claimed = [claim.law for claim in (*lattice.BOUNDS, *lattice.WORDS, *lattice.SCOPES)]
    assert len(set(claimed)) == len(claimed)
    written = {name for module in (laws, hop_laws) for name in vars(module) if "_is_" in name or "_meet_" in name}
    assert written <= {law.__name__ for law in claimed}

    def never(a):
        return False

    monkeypatch.setattr(lattice, "BOUNDS", (lattice.BOUNDS[7], lattice.Claim(never, ((0,),))))
    monkeypatch.setattr(lattice, "WORDS", ())
    monkeypatch.setattr(lattice, "SCOPES", lattice.SCOPES[:1])
    told = [(name, verdict) for name, verdict, _ in prove()]
    assert told == [("within_is_transitive", PROVEN), ("never", REFUTED), ("narrowing_is_an_order", PROVEN)]


def test_a_false_law_is_refuted():
    """The order is not total, the meet not the first of the two, and nothing is nearest to everything."""

    def total(a, b):
        return bounds.within(a, b) or bounds.within(b, a)

    def first(a, b):
        both = bounds.meet(a, b)
        return both is None or both == a

    def lowest(a, value):
        return isinstance(a, Range) and bounds.nearest(a, value) == a.low

    assert lattice.verdict(total, lattice.bound_cases(lattice.Claim(total, ((0, 0),))))[1] == REFUTED
    assert lattice.verdict(first, lattice.bound_cases(lattice.Claim(first, ((0, 2),))))[1] == REFUTED
    assert lattice.verdict(lowest, lattice.bound_cases(lattice.Claim(lowest, ((0,),), 1)))[1] == REFUTED
    assert lattice.verdict(total, iter(()))[1] == REFUTED


def at(term, values):
    """A term or condition where its symbols have these values."""
    return z3.simplify(z3.substitute(term, *[(z3.Int(name), z3.IntVal(value)) for name, value in values.items()]))


def concrete(answer, values):
    match answer:
        case Symbol():
            return at(answer.term, values).as_long()
        case Range(low, high):
            return Range(concrete(low, values), concrete(high, values))
        case OneOf(members):
            return OneOf(frozenset(concrete(member, values) for member in members))
        case _:
            return answer


def named(name, bound):
    if isinstance(bound, Range):
        return {f"{name}_low": bound.low, f"{name}_high": bound.high}
    return {f"{name}_{place}": value for place, value in enumerate(sorted(bound.values))}


def is_less(child, parent):
    return laws.left_out(child, parent) is not None


OPERATIONS = [
    (bounds.permits, 1, 1),
    (bounds.nearest, 1, 1),
    (bounds.size, 1, 0),
    (bounds.meet, 2, 0),
    (bounds.within, 2, 0),
    (bounds.nearest_bound, 2, 0),
    (is_less, 2, 0),
]


@pytest.mark.parametrize(("operation", "takes", "values"), OPERATIONS, ids=lambda each: getattr(each, "__name__", None))
def test_the_ways_are_the_code(operation, takes, values):
    """In a small domain, every case goes exactly one way, and its answer is what the code answers to integers."""
    seen = 0
    for kinds in product((RANGES, SETS), repeat=takes):
        found = list(
            ways(
                lambda run, kinds=kinds: operation(
                    *(symbolic_bound(run, f"b{i}", 0 if kind is RANGES else 2) for i, kind in enumerate(kinds)),
                    *(run.symbol(f"v{i}") for i in range(values)),
                )
            )
        )
        for case in product(*kinds, *[DOMAIN] * values):
            names = {}
            for i, each in enumerate(case):
                names |= {f"v{i - takes}": each} if i >= takes else named(f"b{i}", each)
            taken = [way for way in found if all(z3.is_true(at(condition, names)) for condition in way.conditions)]
            assert len(taken) == 1, (operation, case)
            assert concrete(taken[0].answer, names) == operation(*case), case
            seen += 1
    assert seen == (len(RANGES) + len(SETS)) ** takes * len(DOMAIN) ** values


def test_the_laws_hold_of_every_bound_of_a_small_domain():
    """The proofs once more, by counting: each law asked of every range and set with integers, where symbols were."""
    every = [*RANGES, *SETS, OneOf(frozenset({-2, 0, 2})), OneOf(frozenset({-2, 1, 2}))]
    for claim in lattice.BOUNDS:
        takes = len(claim.shapes[0])
        some = every if takes < 3 else every[::2]
        for case in product(*[some] * takes, *[(-3, -1, 0, 3)] * claim.values):
            assert claim.law(*case), (claim.law.__name__, case)

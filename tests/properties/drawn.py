"""Strategies for scopes: small enough that two of them often touch, and drawn to the edges of one another."""

from __future__ import annotations

from dataclasses import replace

from capabilities.values.algebra import stated
from capabilities.values.budgets import least
from capabilities.values.budgets import meet as meet_budgets
from capabilities.values.bounds import canonical, meet, one_of, permits, within
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import (
    Bound,
    Budget,
    Each,
    Flags,
    Grant,
    Limit,
    OneOf,
    Range,
    Restriction,
    Scope,
    Stems,
    Tier,
    Words,
)
from capabilities.values.units import INT_LIMIT, Kind, ListOf, Parameter, Sort, Unit
from evaluation.tokens.campaigns.laws import Request
from hypothesis import strategies as st
from tests.capabilities.world import CELL, OTHER_CELL

small = st.integers(-8, 8)
extreme = st.sampled_from([-INT_LIMIT, 1 - INT_LIMIT, -1, 0, 1, INT_LIMIT - 1, INT_LIMIT])
numbers = small | small | extreme
ranges = st.tuples(numbers, numbers).map(lambda ends: Range(min(ends), max(ends)))
sets = st.frozensets(numbers, min_size=1, max_size=6).map(lambda values: one_of(*values))
bounds = ranges | sets
loose_bounds = bounds | st.builds(Range, numbers, numbers) | st.frozensets(numbers, max_size=4).map(OneOf)
"""Empty bounds and sets of consecutive integers as well: what no scope may hold, and no function may stumble over."""
UNIVERSE = range(-10, 11)
PARAMETERS = tuple(Parameter(f"p{i}", Unit.COUNT) for i in range(3))
OTHERS = (
    Parameter("flag", Sort.FLAG),
    Parameter("text", Sort.TEXT),
    Parameter("path", Sort.PATH),
    Parameter("url", Sort.URL),
    Parameter("free", Sort.FREE),
    Parameter("files", ListOf(Sort.PATH)),
    Parameter("counts", ListOf(Unit.COUNT)),
)
OPERATIONS = {
    "a": (),
    "b": PARAMETERS[:1],
    "c": PARAMETERS[:2],
    "d": PARAMETERS,
    **{f"{each.name}": (each,) for each in OTHERS},
}
AUDIENCES = (CELL, OTHER_CELL, "http://127.0.0.1:9002/mcp")
DELEGATES = ("x", "y", "role:z")


# --- kinds beside integers -----------------------------------------------------------------------------------------

_COMPONENTS = st.lists(st.sampled_from(["a", "b", "ab"]), min_size=1, max_size=3)
WORDS = {
    Sort.TEXT: st.text(alphabet="ab/é", min_size=1, max_size=3),
    Sort.PATH: _COMPONENTS.map(lambda some: "/" + "/".join(some)),
    Sort.URL: st.tuples(st.sampled_from(["https://a", "https://a:1", "https://ab"]), _COMPONENTS).map(
        lambda two: "/".join((two[0], *two[1][1:]))
    ),
}
"""Words of few components, so that two of them often touch."""


def divider_of(kind: Kind) -> str:
    return "" if kind is Sort.TEXT else "/"


def word_bounds(kind: Sort) -> st.SearchStrategy[Bound]:
    stems = st.frozensets(WORDS[kind], min_size=1, max_size=3) | st.just(frozenset({""}))
    return st.frozensets(WORDS[kind], min_size=1, max_size=4).map(Words) | stems.map(
        lambda values: canonical(Stems(values, divider_of(kind)))
    )


def bounds_of(kind: Kind) -> st.SearchStrategy[Bound]:
    """Bounds of this kind, in their one form."""
    match kind:
        case Sort.FLAG:
            return st.frozensets(st.booleans(), min_size=1).map(Flags)
        case Sort.FREE:
            return st.integers(1, 4).map(lambda most: Range(1, most))
        case Sort():
            return word_bounds(kind)
        case ListOf(element):
            ends = st.tuples(st.integers(0, 2), st.integers(0, 2))
            return st.tuples(bounds_of(element), ends).map(
                lambda two: canonical(Each(two[0], min(two[1]), max(two[1])))
            )
        case _:
            return bounds


def kind_edges(kind: Kind, bound: Bound) -> list[object]:
    """Values at the lines of a bound of this kind, inside and out."""
    match bound:
        case Range() | OneOf():
            return edges(bound)
        case Flags():
            return [False, True]
        case Words(values):
            return sorted({near for word in values for near in (word, f"{word}a", word[:-1])})
        case Stems(values, divider):
            return sorted({near for stem in values for near in (stem, f"{stem}a", stem[:-1], f"{stem}{divider}a")})
        case Each(element, least, most):
            lengths = {max(least - 1, 0), least, most, most + 1}
            members = kind_edges(kind.element, element) if element is not None else [0]
            return [(member,) * length for length in sorted(lengths) for member in members]


@st.composite
def bounds_of_near(draw: st.DrawFn, kind: Kind, bound: Bound) -> Bound:
    """The bound itself, or one of its kind that touches it."""
    if isinstance(bound, (Range, OneOf)) and kind is not Sort.FREE:
        return draw(bounds_near(bound))
    other = draw(bounds_of(kind))
    ways = [bound, other, meet(bound, other) or other]
    match bound:
        case Words(values):
            ways.append(Words(draw(st.frozensets(st.sampled_from(sorted(values)), min_size=1)) | {draw(WORDS[kind])}))
        case Stems(values, divider):
            stem = draw(st.sampled_from(sorted(values)))
            below = f"{stem}{divider}a" if stem else draw(WORDS[kind])
            ways += [Words(frozenset({below})), canonical(Stems(values - {stem} | {below}, divider))]
        case Each(element, least, most) if element is not None:
            ways.append(canonical(Each(draw(bounds_of_near(kind.element, element)), least, most)))
    return draw(st.sampled_from(ways))


@st.composite
def bounds_of_inside(draw: st.DrawFn, kind: Kind, bound: Bound) -> Bound:
    """A bound of its kind within this one."""
    if isinstance(bound, (Range, OneOf)) and kind is not Sort.FREE:
        return draw(bounds_inside(bound))
    near = draw(bounds_of_near(kind, bound))
    return near if within(near, bound) else meet(near, bound) or bound


# --- integers --------------------------------------------------------------------------------------------------------


def edges(bound: Bound) -> list[int]:
    """Each end and member, and its neighbours."""
    ends = (bound.low, bound.high) if isinstance(bound, Range) else sorted(bound.values)
    return sorted({near for end in ends for near in (end - 1, end, end + 1) if abs(near) <= INT_LIMIT})


@st.composite
def bounds_near(draw: st.DrawFn, bound: Bound) -> Bound:
    """The bound itself, or one whose ends are at its edges."""
    at = st.sampled_from(edges(bound))
    return draw(
        st.one_of(
            st.just(bound),
            st.tuples(at, at).map(lambda ends: Range(min(ends), max(ends))),
            st.frozensets(at, min_size=1, max_size=4).map(lambda values: one_of(*values)),
            bounds,
        )
    )


rates = st.lists(st.tuples(st.sampled_from([2, 3, 4, 6]), st.integers(1, 6)), max_size=2)


def shared(measures: list[tuple[int, int]]) -> tuple[Budget, ...]:
    """Budgets of acts of these windows and numbers, the same at every audience."""
    return least(Budget("", audience, window, most) for window, most in measures for audience in AUDIENCES)


some_budgets = st.just(()) | rates.map(shared)


@st.composite
def scopes(draw: st.DrawFn) -> Scope:
    names = sorted(draw(st.sets(st.sampled_from(sorted(OPERATIONS)), min_size=1, max_size=4)))
    grants = tuple(
        Grant(
            "arm", name, tuple(Limit(each, draw(bounds_of(each.kind))) for each in OPERATIONS[name]), draw(some_budgets)
        )
        for name in names
    )
    start = draw(st.integers(0, 20))
    return Scope(
        grants=grants,
        ceiling=draw(st.sampled_from(Tier)),
        audiences=draw(st.frozensets(st.sampled_from(AUDIENCES), min_size=1)),
        delegates=draw(st.frozensets(st.sampled_from(DELEGATES))),
        depth=draw(st.integers(0, DEFAULT.hops)),
        not_before=start,
        not_after=start + draw(st.integers(1, 20)),
    )


@st.composite
def restrictions(draw: st.DrawFn) -> Restriction:
    """Any restriction, of any scope."""
    other = draw(scopes())
    kept = {name: draw(st.booleans()) for name in Restriction.__dataclass_fields__}
    thinned = tuple(
        replace(grant, limits=tuple(limit for limit in grant.limits if draw(st.booleans()))) for grant in other.grants
    )
    values = {name: (thinned if name == "grants" else getattr(other, name)) for name, keep in kept.items() if keep}
    return Restriction(**values)


@st.composite
def bounds_inside(draw: st.DrawFn, bound: Bound) -> Bound:
    """A bound within this one, mostly at its edges."""
    at = st.sampled_from([value for value in edges(bound) if permits(bound, value)])
    inner = st.tuples(at, at).map(lambda ends: Range(min(ends), max(ends)))
    some = st.frozensets(at, min_size=1, max_size=4).map(lambda values: one_of(*values))
    return draw(st.just(bound) | some | inner.filter(lambda child: within(child, bound)))


@st.composite
def restrictions_near(draw: st.DrawFn, parent: Scope) -> Restriction:
    """Restriction that takes a little from `parent` or nothing; half of them also ask for a little more."""
    greedy = draw(st.booleans())

    def rarely() -> bool:
        return greedy and draw(st.integers(0, 4)) == 0

    def step(value: int, less: int, low: int, high: int) -> int:
        ways = [0, less, -less] if greedy else [0, less]
        return min(max(value + draw(st.sampled_from(ways)), low), high)

    def names(held: frozenset[str], all_: tuple[str, ...], least: int) -> frozenset[str]:
        few = frozenset(name for name in sorted(held) if draw(st.integers(0, 3)))
        more = few | {draw(st.sampled_from(all_))} if rarely() else few
        return more if len(more) >= least else held

    near = bounds_of_near if greedy else bounds_of_inside
    grants = []
    for grant in parent.grants:
        if len(parent.grants) > 1 and draw(st.integers(0, 3)) == 0:
            continue
        limits = [
            Limit(limit.parameter, draw(near(limit.parameter.kind, limit.bound)))
            for limit in grant.limits
            if draw(st.booleans())
        ]
        if rarely():
            limits.append(Limit(Parameter("other", Unit.GRAM), draw(bounds)))
        pace = draw(some_budgets)
        own = pace if rarely() else meet_budgets(grant.budgets, pace)
        grants.append(Grant(grant.object, grant.operation, tuple(limits), own if draw(st.booleans()) else ()))
    if rarely():
        grants.append(Grant("arm", "z", ()))
    stated_grants = tuple(grants) or None
    return Restriction(
        grants=draw(st.sampled_from([None, stated_grants, stated_grants])),
        ceiling=draw(st.none() | st.just(Tier(step(parent.ceiling, -1, 0, 4)))),
        audiences=draw(st.none() | st.just(names(parent.audiences, AUDIENCES, 1))),
        delegates=draw(st.none() | st.just(names(parent.delegates, DELEGATES, 0))),
        depth=draw(st.none() | st.just(step(max(parent.depth, 1) - 1, -1, 0, 8))),
        not_before=draw(st.none() | st.just(step(parent.not_before, 1, 0, 99))),
        not_after=draw(st.none() | st.just(step(parent.not_after, -1, 0, 99))),
    )


@st.composite
def families(draw: st.DrawFn, count: int) -> tuple[Scope, ...]:
    """Scopes of which each is often a little below the one before, or above it, or the same."""
    family = [draw(scopes())]
    while len(family) < count:
        last = family[-1]
        child = stated(last, draw(restrictions_near(last)))
        well = child.depth >= 0 and child.not_before < child.not_after
        family.append(draw(st.sampled_from([child, child, child, last])) if well else draw(scopes()))
    return tuple(draw(st.permutations(family)))


@st.composite
def requests(draw: st.DrawFn, *scopes_: Scope) -> Request:
    """A request at the edges of what these scopes permit."""
    scope = draw(st.sampled_from(scopes_))
    grant = draw(st.sampled_from(scope.grants))
    values = tuple(draw(st.sampled_from(kind_edges(limit.parameter.kind, limit.bound))) for limit in grant.limits)
    if draw(st.integers(0, 19)) == 0:
        values = (*values, 0)
    at = draw(st.sampled_from([scope.not_before - 1, scope.not_before, scope.not_after - 1, scope.not_after]))
    return Request(
        (grant.object, grant.operation), values, draw(st.integers(0, 5)), at, draw(st.sampled_from(AUDIENCES))
    )


@st.composite
def hops(draw: st.DrawFn) -> tuple[Scope, Restriction]:
    """A parent and a restriction, mostly of that very parent."""
    parent = draw(scopes())
    return parent, draw(restrictions_near(parent) | restrictions_near(parent) | restrictions())

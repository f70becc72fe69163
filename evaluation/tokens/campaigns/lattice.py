"""The laws of the scope algebra for all integers, shown with z3 by running the code itself on symbols.

A law is proven when every way through it, with every shape of bound, answers that it holds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise, permutations, product
from typing import TYPE_CHECKING, Any, Final

import z3

from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Scope, Stems, Tier, Words
from capabilities.values.units import Parameter, Unit
from evaluation.tokens.campaigns import hop_laws, laws
from evaluation.tokens.campaigns.symbolic import INTEGERS, TEXTS, UndecidedError, ways

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities.values.scope import Bound
    from capabilities.values.stems import WordBound
    from evaluation.tokens.campaigns.symbolic import Run, Symbol

PROVEN: Final = "proven"
REFUTED: Final = "refuted"
UNDECIDED: Final = "undecided"

Law = tuple[str, str, float]
"""Name, verdict and seconds."""


@dataclass(frozen=True, slots=True)
class Claim:
    """Law of bounds with the shapes that it is proven for: members of each bound, 0 for a range."""

    law: Callable[..., bool]
    shapes: tuple[tuple[int, ...], ...]
    values: int = 0


def _all(count: int, *sizes: int) -> tuple[tuple[int, ...], ...]:
    """Every combination of these sizes."""
    return tuple(product(sizes, repeat=count))


BOUNDS: Final = (
    Claim(laws.meet_is_the_intersection, _all(2, 0, 2, 3, 4), 1),
    Claim(laws.meet_is_the_greatest_below_both, (*_all(3, 0, 2), (3, 3, 3), (4, 4, 2))),
    Claim(laws.meet_commutes, _all(2, 0, 2, 3, 4)),
    Claim(laws.meet_associates, _all(3, 0, 2)),
    Claim(laws.meet_is_monotone, (*_all(3, 0, 2), (3, 4, 3))),
    Claim(laws.within_is_subset, _all(2, 0, 2, 3, 4), 1),
    Claim(laws.within_is_antisymmetric, _all(2, 0, 2, 3, 4)),
    Claim(laws.within_is_transitive, (*_all(3, 0, 2), (3, 3, 4))),
    Claim(laws.less_is_left_out, _all(2, 0, 2, 3, 4)),
    Claim(laws.nearest_is_nearest, _all(1, 0, 2, 3, 4), 2),
    Claim(laws.nearest_bound_is_nearest, (*_all(2, 0, 2), (0, 3), (3, 0)), 2),
    Claim(laws.every_nearest_is_inside, _all(2, 0, 2), 1),
)


@dataclass(frozen=True, slots=True)
class WordClaim:
    """Law of words and stems, with the numbers of members that it is proven for; below 0 for stems."""

    law: Callable[..., bool]
    shapes: tuple[tuple[int, ...], ...]
    values: int = 0


WORDS: Final = (
    WordClaim(laws.words_meet_in_the_intersection, _all(2, 1, -1), 1),
    WordClaim(laws.words_meet_in_the_greatest, ((-1, -1, -1), (1, -1, -1), (-1, -1, 1))),
    WordClaim(laws.words_meet_in_any_order, ((1, -1, -1),)),  # three stems are too much for the solver
    WordClaim(laws.words_narrow_in_an_order, _all(3, 1, -1)),
)


@dataclass(frozen=True, slots=True)
class ScopeClaim:
    """A law of scopes: how many scopes it takes, and whether a request or a restriction comes after them."""

    law: Callable[..., bool]
    scopes: int
    request: bool = False
    restriction: bool = False


SCOPES: Final = (
    ScopeClaim(laws.narrowing_is_an_order, 3),
    ScopeClaim(laws.a_child_permits_no_more, 2, request=True),
    ScopeClaim(laws.strict_is_less, 2, request=True),
    ScopeClaim(laws.scopes_meet_in_the_intersection, 2, request=True),
    ScopeClaim(laws.scopes_meet_in_the_greatest, 3),
    ScopeClaim(laws.scopes_meet_in_any_order, 3),
    ScopeClaim(hop_laws.a_hop_is_the_meet, 1, restriction=True),
    ScopeClaim(hop_laws.a_refused_hop_asks_too_much, 1, restriction=True),
    ScopeClaim(hop_laws.repair_is_the_nearest, 1, restriction=True),
    ScopeClaim(hop_laws.every_nearest_is_permitted, 1, restriction=True),
    ScopeClaim(hop_laws.the_nearest_window_is_that_of_seconds, 1, restriction=True),
)


def prove() -> list[Law]:
    """Every law with its verdict and the seconds that it took."""
    return [prove_one(claim) for claim in (*BOUNDS, *WORDS, *SCOPES)]


def prove_one(claim: Claim | WordClaim | ScopeClaim) -> Law:
    """One law, with its verdict and the seconds that it took."""
    if isinstance(claim, WordClaim):
        return verdict(claim.law, word_cases(claim), TEXTS)
    return verdict(claim.law, bound_cases(claim) if isinstance(claim, Claim) else scope_cases(claim))


def verdict(law: Callable[..., bool], cases: Iterator[Callable[[Run], bool]], logic: str = INTEGERS) -> Law:
    """Result of a law over every case: it must hold on every way through each."""
    began = time.perf_counter()
    try:
        # A law that no way goes through would hold of nothing.
        answers = [all(way.answer for way in ways(case, logic)) for case in cases]
    except UndecidedError:
        return law.__name__, UNDECIDED, time.perf_counter() - began
    return law.__name__, PROVEN if answers and all(answers) else REFUTED, time.perf_counter() - began


# --- symbolic bounds -------------------------------------------------------------------------------------------------


def symbolic_bound(run: Run, name: str, members: int) -> Bound:
    """Symbolic bound: any range, or any set of this many integers that are not consecutive."""
    if not members:
        low, high = run.symbol(f"{name}_low"), run.symbol(f"{name}_high")
        run.assume(low.term <= high.term)
        return Range(_int(low), _int(high))
    symbols = [run.symbol(f"{name}_{place}") for place in range(members)]
    # Every set can be written in ascending order.
    run.assume(*(one.term < other.term for one, other in pairwise(symbols)))
    run.assume(symbols[-1].term - symbols[0].term > members - 1)
    return OneOf(frozenset(map(_int, symbols)))


def _int(symbol: Symbol) -> Any:
    """Read as an integer, which a symbol stands for."""
    return symbol


def bound_cases(claim: Claim) -> Iterator[Callable[[Run], bool]]:
    """The law, asked of symbolic bounds of each shape."""
    for shape in claim.shapes:

        def case(run: Run, shape: tuple[int, ...] = shape) -> bool:
            named = [symbolic_bound(run, f"b{place}", members) for place, members in enumerate(shape)]
            return claim.law(*named, *(_int(run.symbol(f"v{place}")) for place in range(claim.values)))

        yield case


# --- symbolic words --------------------------------------------------------------------------------------------------


def symbolic_words(run: Run, name: str, members: int, divider: Any) -> WordBound:
    """Symbolic bound: any set of so many words, or of so many stems of which none is inside another."""
    symbols = [run.text(f"{name}_{place}") for place in range(abs(members))]
    for one, other in permutations(symbols, 2):
        below = z3.PrefixOf(z3.Concat(one.term, z3.StringVal(divider)), other.term)
        inside = z3.Or(one.term == z3.StringVal(""), one.term == other.term, below)
        run.assume(z3.Not(inside) if members < 0 else one.term != other.term)
    values: Any = frozenset(symbols)
    return Words(values) if members > 0 else Stems(values, divider)


def word_cases(claim: WordClaim) -> Iterator[Callable[[Run], bool]]:
    """The law, asked of symbolic words and stems of each shape, of texts and of paths."""
    for shape, divider in product(claim.shapes, ("", "/")):

        def case(run: Run, shape: tuple[int, ...] = shape, divider: str = divider) -> bool:
            named = [symbolic_words(run, f"b{place}", members, divider) for place, members in enumerate(shape)]
            return claim.law(*named, *(run.text(f"v{place}") for place in range(claim.values)))

        yield case


# --- symbolic scopes -------------------------------------------------------------------------------------------------

_FIXED: Final = Limit(Parameter("p", Unit.COUNT), Range(0, 1))
_MOVE: Final = Grant("arm", "move", (_FIXED,))
_NAMES: Final = frozenset({"here"})
_DIMENSIONS: Final = ("limit", "ceiling", "depth", "window")


def scope_cases(claim: ScopeClaim) -> Iterator[Callable[[Run], bool]]:
    """The law, asked first of scopes with symbolic numbers and then of scopes with symbolic names."""
    # All numbers at once for two scopes; of three, whose ways multiply, those of one dimension at a time.
    groups = (_DIMENSIONS,) if claim.scopes < 3 else tuple((each,) for each in _DIMENSIONS)
    for group in groups:

        def numbers(run: Run, group: tuple[str, ...] = group) -> bool:
            scopes = [_numbers(run, f"s{place}", group) for place in range(claim.scopes)]
            asked: list[Any] = [_request(run, scopes[-1])] if claim.request else []
            return claim.law(*scopes, *asked, *([_fewer_numbers(run)] if claim.restriction else []))

        yield numbers
    for shape in _shapes(claim.scopes + claim.restriction):

        def names(run: Run, shape: tuple[_Names, ...] = shape) -> bool:
            scopes: list[Any] = [_named(run, f"s{place}", each) for place, each in enumerate(shape)]
            asked: list[Any] = [_request(run, scopes[-1])] if claim.request else []
            if claim.restriction:
                stated = scopes.pop()
                asked.append(Restriction(stated.grants, None, stated.audiences, stated.delegates))
            return claim.law(*scopes, *asked)

        yield names


def _numbers(run: Run, name: str, group: tuple[str, ...]) -> Scope:
    """Scope with any numbers in these dimensions, and the others fixed."""
    scope = Scope((_MOVE,), Tier(1), _NAMES, _NAMES, 1, 0, 9)
    if "limit" in group:
        limit = Limit(_FIXED.parameter, symbolic_bound(run, name, 0))
        scope = replace(scope, grants=(replace(_MOVE, limits=(limit,)),))
    if "ceiling" in group:
        scope = replace(scope, ceiling=_natural(run, f"{name}_ceiling"))
    if "depth" in group:
        scope = replace(scope, depth=_natural(run, f"{name}_depth"))
    if "window" in group:
        start, end = run.symbol(f"{name}_start"), run.symbol(f"{name}_end")
        run.assume(start.term < end.term)
        scope = replace(scope, not_before=_int(start), not_after=_int(end))
    return scope


def _natural(run: Run, name: str) -> Any:
    symbol = run.symbol(name)
    run.assume(symbol.term >= 0)
    return symbol


def _fewer_numbers(run: Run) -> Restriction:
    """Restriction with numbers as of a scope, without an order between the ends of the window."""
    limit = Limit(_FIXED.parameter, symbolic_bound(run, "r", 0))
    ceiling, depth = _natural(run, "r_ceiling"), _natural(run, "r_depth")
    start, end = _int(run.symbol("r_start")), _int(run.symbol("r_end"))
    return Restriction((replace(_MOVE, limits=(limit,)),), ceiling, None, None, depth, start, end)


_Names = tuple[tuple[str, ...], int, int]
"""The operations of a scope, and how many audiences and delegates it has."""


def _shapes(count: int) -> Iterator[tuple[_Names, ...]]:
    if count == 2:
        held = (("move",), ("move", "stop"), ("stop",))
        yield from product([(grants, 2, 1) for grants in held], repeat=count)
        yield from product([(("stop",), 1, 0), (("stop",), 1, 2)], repeat=count)
    else:
        yield from product([(("move",), 1, 0), (("move", "stop"), 1, 0)], repeat=count)
        yield from product([(("stop",), 1, 1), (("stop",), 2, 0)], repeat=count)


def _named(run: Run, name: str, names: _Names) -> Scope:
    """Scope with any audiences and delegates, and fixed numbers.

    Integers stand in place of names, since only sameness counts.
    """
    grants, audiences, delegates = names
    held = tuple(Grant("arm", grant, (_FIXED,) if grant == "move" else ()) for grant in grants)
    return Scope(
        held,
        Tier(1),
        _distinct(run, f"{name}_audience", audiences),
        _distinct(run, f"{name}_delegate", delegates),
        1,
        0,
        9,
    )


def _distinct(run: Run, name: str, count: int) -> frozenset[Any]:
    symbols = [run.symbol(f"{name}_{place}") for place in range(count)]
    run.assume(*(one.term < other.term for one, other in pairwise(symbols)))
    return frozenset(map(_int, symbols))


def _request(run: Run, scope: Scope) -> laws.Request:
    grant = scope.grants[0]
    values = tuple(_int(run.symbol(f"v{place}")) for place in range(len(grant.limits)))
    tier, at, audience = (_int(run.symbol(name)) for name in ("tier", "at", "audience"))
    return laws.Request(
        (grant.object, grant.operation), values, tier, at, "here" if scope.audiences is _NAMES else audience
    )

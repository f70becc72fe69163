"""Random chains of up to eight hops, issued as the library issues, and hops that were forged below them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capabilities.values import budgets
from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.scope import Bound, Budget, Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.values.units import INT_LIMIT, Parameter, Unit
from evaluation.tokens.campaigns import kinds, twin
from evaluation.tokens.campaigns.issuer import ATTESTED_AT, CELLS, SPONSOR, chain_of

if TYPE_CHECKING:
    from random import Random

    from capabilities.token.verify import Verifier
    from capabilities.values.chain import Chain, HopGrant
    from evaluation.tokens.campaigns.issuer import Issuer
    from evaluation.tokens.campaigns.twin import Blocks

HOPS: Final = 8
AGENTS: Final = tuple(f"a{n}" for n in range(HOPS + 1))
ROLE: Final = "planner"
ARM: Final = "arm"
KEPT: Final = ((ARM, "z"), (ARM, "y"))
"""Operations that every chain keeps: one with a range and a set, one with a parameter of each other kind."""
RANGE: Final = Parameter("low_high", Unit.MICROMETRE)
SET: Final = Parameter("one_of", Unit.COUNT)
_WORDS: Final = ("a", "b", "c", "read", "right", "query")
_UNITS: Final = (Unit.COUNT, Unit.MICROMETRE, Unit.MILLINEWTON)
_TRIES: Final = 12


@dataclass(frozen=True, slots=True)
class Family:
    """A chain as it grew.

    Attributes:
        blocks: the restrictions that the issuer was asked for.
        tokens: after each block.
        chains: each token, verified.
    """

    blocks: Blocks
    tokens: tuple[bytes, ...]
    chains: tuple[Chain, ...]


# --- bounds ----------------------------------------------------------------------------------------------------------


def integers(values: set[int]) -> Bound:
    """The bound of exactly these integers: a range when they are consecutive."""
    low, high = min(values), max(values)
    return Range(low, high) if high - low + 1 == len(values) else OneOf(frozenset(values))


def _range(chance: Random) -> Range:
    most = chance.choice((3, 9, 1_000, INT_LIMIT))
    ends = chance.randint(-most, most), chance.randint(-most, most)
    return Range(min(ends), max(ends))


def _set(chance: Random) -> Bound:
    size = chance.choice((2, 3, 5, 9))
    first = chance.choice((-INT_LIMIT, -20, 0, 5))
    return OneOf(frozenset({first + 2, *(first + chance.randrange(4, 40) for _ in range(size))}))


def inner(bound: Bound, chance: Random) -> Bound:
    """A bound of integers inside `bound`, often with an end in common."""
    if not isinstance(bound, (Range, OneOf)):
        raise TypeError("not a bound of integers")
    if isinstance(bound, OneOf):
        kept = {value for value in bound.values if chance.random() < 0.7}
        return integers(kept or {min(bound.values)})
    low, high = bound.low, bound.high
    inside = (low, low + 1, low + 2, (low + high) // 2, high - 2, high - 1, high)
    ends = sorted(chance.choice([point for point in inside if low <= point <= high]) for _ in range(2))
    if chance.random() < 0.2:
        return integers(set(ends))
    return Range(*ends)


def within_limit(limit: Limit, chance: Random) -> Bound:
    """A bound inside the limit's."""
    if limit.parameter in kinds.DIMENSIONS.values():
        return kinds.inner(limit.parameter.kind, limit.bound, chance)
    return inner(limit.bound, chance)


# --- budgets ---------------------------------------------------------------------------------------------------------


def _budgets(chance: Random) -> budgets.Budgets:
    """One budget of acts, or two, with shares for every audience."""
    windows = chance.sample((7, 60, 3_600, budgets.LONGEST_S), chance.choice((1, 1, 2)))
    drawn = [(window, chance.choice((3, 50, 1_000))) for window in windows]
    return budgets.least(Budget("", cell, window, most) for window, most in drawn for cell in CELLS)


def tighter(held: budgets.Budgets, chance: Random) -> budgets.Budgets:
    """Budgets that imply the held ones: fewer acts, a longer window, or a pace beside them."""
    ways: tuple[tuple[int, int], ...] = tuple(
        (window, most)
        for each in held[:1]
        for window, most in (
            (each.window_s, each.most - 1),
            (each.window_s + 1, each.most),
            (each.window_s // 2, each.most // 2),
            (3, max(2, each.most // 3)),
        )
        if most >= 1 <= window <= budgets.LONGEST_S
    )
    if not ways:
        return held
    window, most = chance.choice(ways)
    return budgets.meet(held, tuple(Budget("", cell, window, most) for cell in CELLS))


def beside(held: budgets.Budgets, chance: Random) -> budgets.Budgets:
    """The held budgets with one of them at its line, or a step beside it, at every audience."""
    line = chance.choice(held)
    window, most = line.window_s + chance.choice((-1, 0, 1)), line.most + chance.choice((-1, 0, 1))
    moved = Budget("", line.audience, min(max(window, 1), budgets.LONGEST_S), max(most, 1))
    return budgets.least(
        replace(moved, audience=each.audience) if each.window_s == line.window_s else each for each in held
    )


# --- chains ----------------------------------------------------------------------------------------------------------


def _first(chance: Random) -> Scope:
    grants = []
    for thing in (ARM, "hand"):
        for operation in chance.sample(_WORDS, chance.randint(1, 3)):
            limits = [Limit(RANGE, _range(chance)), Limit(SET, _set(chance))] if chance.random() < 0.8 else []
            for n in range(chance.choice((0, 0, 1, 3))):
                bound = _range(chance) if chance.random() < 0.5 else _set(chance)
                limits.append(Limit(Parameter(f"p{n}", chance.choice(_UNITS)), bound))
            grants.append(Grant(thing, operation, tuple(limits)))
    grants.append(Grant(*KEPT[0], (Limit(RANGE, _range(chance)), Limit(SET, _set(chance))), _budgets(chance)))
    grants.append(Grant(*KEPT[1], kinds.limits(chance)))
    return Scope(
        grants=tuple(sorted(grants, key=lambda grant: (grant.object, grant.operation))),
        ceiling=Tier(chance.randint(1, 3)),
        audiences=frozenset(CELLS),
        delegates=frozenset({*AGENTS[1:], *(f"spare-{n}" for n in range(1, HOPS + 1)), f"role:{ROLE}"}),
        depth=HOPS,
        not_before=ATTESTED_AT + chance.randint(0, 5),
        not_after=ATTESTED_AT + chance.randint(600, 3_000),
    )


def narrower(held: Scope, further: tuple[str, ...], chance: Random) -> Restriction:
    """A restriction of `held` that leaves enough for further hops to these agents."""
    grants = None
    if chance.random() < 0.8:
        kept = [g for g in held.grants if (g.object, g.operation) in KEPT or chance.random() < 0.85]
        grants = tuple(
            Grant(
                g.object,
                g.operation,
                tuple(Limit(x.parameter, within_limit(x, chance)) for x in g.limits if chance.random() < 0.4),
                tighter(g.budgets, chance) if g.budgets and chance.random() < 0.4 else (),
            )
            for g in kept
        )
    spare = frozenset(each for each in held.delegates - set(further) if not each.startswith("spare"))
    return Restriction(
        grants=grants,
        ceiling=Tier(chance.randint(0, held.ceiling)) if chance.random() < 0.15 else None,
        audiences=_some(held.audiences - {CELLS[0]}, chance) | {CELLS[0]} if chance.random() < 0.3 else None,
        delegates=held.delegates - _some(spare, chance) if chance.random() < 0.5 else None,
        depth=chance.randint(len(further), held.depth - 1) if chance.random() < 0.4 else None,
        not_before=held.not_before + chance.randint(0, 1) if chance.random() < 0.3 else None,
        not_after=held.not_after - chance.randint(0, 9) if chance.random() < 0.5 else None,
    )


def _some(members: frozenset[str], chance: Random) -> frozenset[str]:
    return frozenset(member for member in sorted(members) if chance.random() < 0.5)


def family(issuer: Issuer, verifier: Verifier, hops: int, chance: Random) -> Family:
    """Chain of so many hops, or of fewer where it grows too large, with every token issued and verified.

    Raises:
        RuntimeError: when an issued token is refused.
    """
    first = _first(chance)
    tokens = [issuer.mint(first, issuer.holder(AGENTS[0], SPONSOR.subject))]
    chains = [chain_of(verifier, tokens[0])]
    restrictions: list[Restriction] = []
    for n in range(1, hops + 1):
        hop = holder(issuer, chains[-1], n, chance)
        restriction = _fitting(chains[-1], AGENTS[n + 1 : hops + 1], chance)
        try:
            tokens.append(issuer.delegate(tokens[-1], chains[-1], hop, restriction))
        except TokenError as error:
            if error.code is not FaultCode.TOKEN_TOO_LARGE:
                raise
            break
        restrictions.append(restriction)
        chains.append(chain_of(verifier, tokens[-1]))
    return Family((whole(first), *restrictions), tuple(tokens), tuple(chains))


def holder(issuer: Issuer, chain: Chain, hop: int, chance: Random) -> HopGrant:
    """The next holder: named itself, or by the role that it has."""
    by_role = f"role:{ROLE}" in chain.scope.delegates and chance.random() < 0.4
    agent = f"planner-{hop}" if by_role else AGENTS[hop]
    return issuer.holder(agent, chain.leaf.agent, role=ROLE if by_role or chance.random() < 0.3 else "")


def _fitting(chain: Chain, further: tuple[str, ...], chance: Random) -> Restriction:
    """A restriction that narrows the leaf's scope somewhere."""
    for _ in range(_TRIES):
        restriction = narrower(chain.scope, further, chance)
        if twin.less((whole(chain.scope),), lay_over(chain.scope, restriction)):
            return restriction
    # Nothing random narrowed it. Every holder has a name to spare that nobody else drops.
    return Restriction(delegates=chain.scope.delegates - {f"spare-{len(chain.hops)}"})


def lay_over(held: Scope, restriction: Restriction) -> Scope:
    """Scope that a restriction asks for, wider places included."""
    grants = []
    for asked in held.grants if restriction.grants is None else restriction.grants:
        above = [each for each in held.grants if (each.object, each.operation) == (asked.object, asked.operation)]
        own = {limit.parameter: limit for limit in asked.limits}
        limits = tuple(own.get(limit.parameter, limit) for limit in above[0].limits) if above else asked.limits
        grants.append(
            Grant(asked.object, asked.operation, limits, asked.budgets or (above[0].budgets if above else ()))
        )
    kept = {
        name: getattr(held if getattr(restriction, name) is None else restriction, name)
        for name in ("ceiling", "audiences", "delegates", "not_before", "not_after")
    }
    return Scope(grants=tuple(grants), depth=held.depth - 1 if restriction.depth is None else restriction.depth, **kept)


def whole(scope: Scope) -> Restriction:
    """The restriction that states all of a scope."""
    return Restriction(
        scope.grants, scope.ceiling, scope.audiences, scope.delegates, scope.depth, scope.not_before, scope.not_after
    )


# --- forged hops -----------------------------------------------------------------------------------------------------

FORGED: Final = (
    *("grants", "ranges", "sets", *kinds.DIMENSIONS, "budgets"),
    *("ceiling", "audience", "delegates", "depth", "window", "idle", "stranger"),
)
"""Excess of a forged hop; "idle" narrows nothing, and no block names the agent of "stranger"."""


def too_much(what: str, held: Scope, chance: Random) -> Restriction:
    """A restriction that narrows somewhere and has a little more than `held` in one dimension."""
    ends = held.grants[:1] + held.grants[1:][-1:]
    fair = Restriction(grants=ends, audiences=frozenset({CELLS[0]}), delegates=frozenset())
    match what:
        case "grants":
            extra = Grant("zz", "read") if chance.random() < 0.5 else Grant(held.grants[-1].object, "zz")
            return replace(fair, grants=(*held.grants[:1], extra))
        case "ranges" | "sets":
            return replace(fair, grants=(_loosened(held, RANGE if what == "ranges" else SET, chance),))
        case _ if what in kinds.DIMENSIONS:
            return replace(fair, grants=(_of_a_kind(held, kinds.DIMENSIONS[what], chance),))
        case "budgets":
            return replace(fair, grants=(_faster(held, chance),))
        case "ceiling":
            return replace(fair, ceiling=Tier(min(held.ceiling + 1, Tier.SAFETY_CRITICAL)))
        case "audience":
            return replace(
                fair, audiences=held.audiences | {chance.choice(("https://cell-9.example", CELLS[0] + "/x"))}
            )
        case "delegates":
            return replace(fair, delegates=held.delegates | {chance.choice(("a", "role:a1", "role:planne", "A1"))})
        case "depth":
            return replace(fair, depth=held.depth + chance.choice((0, 1)))
        case "window":
            if chance.random() < 0.5:
                return replace(fair, not_after=held.not_after + 1)
            return replace(fair, not_before=held.not_before - 1)
        case "idle":
            return Restriction(not_after=held.not_after - 1, depth=0)
        case "stranger":
            return fair
        case _:
            raise ValueError(what)


def _loosened(held: Scope, parameter: Parameter, chance: Random) -> Grant:
    """The grant that every chain keeps, with one integer more for this parameter."""
    grant = _grant(held, KEPT[0])
    (bound,) = (limit.bound for limit in grant.limits if limit.parameter == parameter)
    if not isinstance(bound, (Range, OneOf)):
        raise TypeError("not a bound of integers")
    if isinstance(bound, Range) and bound.low < bound.high:
        more: Bound = Range(bound.low - 1, bound.high) if chance.random() < 0.5 else Range(bound.low, bound.high + 1)
    else:
        members = {bound.low} if isinstance(bound, Range) else set(bound.values)
        more = integers(members | {chance.choice([p for p in twin.points(bound) if p not in members])})
    return Grant(*KEPT[0], (Limit(parameter, more),))


def _faster(held: Scope, chance: Random) -> Grant:
    """The grant that every chain keeps, with an act more in one of its budgets, or a second less."""
    own = _grant(held, KEPT[0]).budgets
    line = chance.choice(own)
    more = replace(line, most=line.most + 1)
    if line.window_s > 1 and chance.random() < 0.5:
        more = replace(line, window_s=line.window_s - 1)
    return Grant(*KEPT[0], (), budgets.least(more if each == line else each for each in own))


def _of_a_kind(held: Scope, parameter: Parameter, chance: Random) -> Grant:
    """The grant that every chain keeps, with a value more for this parameter."""
    (bound,) = (limit.bound for limit in _grant(held, KEPT[1]).limits if limit.parameter == parameter)
    more = kinds.more(bound, chance)
    # Of what has every value there is no more, but of a range there is.
    return _loosened(held, RANGE, chance) if more == bound else Grant(*KEPT[1], (Limit(parameter, more),))


def _grant(held: Scope, pair: tuple[str, str]) -> Grant:
    return next(each for each in held.grants if (each.object, each.operation) == pair)

"""Twin of the algebra: a chain of blocks in the slow and obvious way, where any block may say no.

It is a second opinion on the algebra of scopes and uses none of it: no order, no meet, no scope laid over another.
Inclusion of one set of integers in another is tested at points: both are unions of few ranges, so one that sticks out
does so at an end of its own, or just beside a member or an end of the other. Of words it does so at a word or stem of
its own, or after a stem.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from capabilities.values.arguments import is_of, measured
from capabilities.values.scope import Each, Flags, Grant, OneOf, Range, Restriction, Scope, Stems, Tier, Words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from capabilities.values.arguments import Value
    from capabilities.values.scope import Bound, Budget
    from capabilities.values.units import Parameter

Blocks = tuple[Restriction, ...]
"""Statements of the blocks of a token, in order. The first one states everything."""


@dataclass(frozen=True, slots=True)
class TriedAct:
    """A request to act."""

    object: str
    operation: str
    values: tuple[Value, ...]
    base_tier: Tier
    at: int
    audience: str


@dataclass(frozen=True, slots=True)
class Lend:
    """Request to delegate: the delegate, and the whole scope. The scope states every dimension."""

    agent: str
    role: str
    scope: Scope


# --- acting ----------------------------------------------------------------------------------------------------------


def acts(blocks: Blocks, act: TriedAct) -> list[bool]:
    """Answers for the holder after each block: true where no block so far refuses the request."""
    answers: list[bool] = []
    for block in blocks:
        answers.append((answers[-1] if answers else _shaped(blocks[0], act)) and _allows(block, act))
    return answers


def _shaped(first: Restriction, act: TriedAct) -> bool:
    """Exactly the parameters that the first block lists for the operation, in order, each of its kind."""
    for grant in first.grants or ():
        if (grant.object, grant.operation) == (act.object, act.operation):
            listed = [limit.parameter for limit in grant.limits]
            return [each.name for each in listed] == [value.name for value in act.values] and all(
                is_of(parameter.kind, value) for parameter, value in zip(listed, act.values, strict=True)
            )
    return False


def _allows(block: Restriction, act: TriedAct) -> bool:
    if block.grants is not None:
        same = [g for g in block.grants if (g.object, g.operation) == (act.object, act.operation)]
        if not same:
            return False
        for limit in same[0].limits:
            for value in act.values:
                if value.name == limit.parameter.name and not inside(limit.bound, measured(value)):
                    return False
    if block.ceiling is not None and act.base_tier > block.ceiling:
        return False
    if block.audiences is not None and act.audience not in block.audiences:
        return False
    if block.not_before is not None and act.at < block.not_before:
        return False
    return not (block.not_after is not None and act.at >= block.not_after)


def inside(bound: Bound, value: Any) -> bool:
    """True where a value is in a bound: paths and URLs by components, texts by characters."""
    match bound:
        case Range(low, high):
            return bool(low <= value <= high)
        case OneOf(values) | Flags(values) | Words(values):
            return value in values
        case Stems(values, divider):
            return any(not stem or _leading(stem, value, divider) for stem in values)
        case Each(element, least, most):
            return least <= len(value) <= most and not any(
                element is None or not inside(element, member) for member in value
            )


def _leading(stem: str, word: str, divider: str) -> bool:
    parts, others = (stem.split("/"), word.split("/")) if divider else (list(stem), list(word))
    return others[: len(parts)] == parts


# --- lending ---------------------------------------------------------------------------------------------------------


def lends(blocks: Blocks, holders: Sequence[str], lend: Lend) -> list[bool]:
    """Answers for the holder after each block: true where it may delegate so. Nobody holds twice."""
    return [lend.agent not in holders[: n + 1] and _may_lend(blocks[: n + 1], lend) for n in range(len(blocks))]


def _may_lend(blocks: Sequence[Restriction], lend: Lend) -> bool:
    names = {lend.agent} | ({f"role:{lend.role}"} if lend.role else set())
    named = all(block.delegates is None or names & block.delegates for block in blocks)
    return (
        named and depth(blocks) > lend.scope.depth >= 0 and not wider(blocks, lend.scope) and less(blocks, lend.scope)
    )


def depth(blocks: Sequence[Restriction]) -> int:
    """Number of hops that may follow after these blocks."""
    left = 0
    for block in blocks:
        left = block.depth if block.depth is not None else left - 1
    return left


def wider(blocks: Sequence[Restriction], scope: Scope) -> bool:
    """True where a scope has anything, but for depth, that one of the blocks does not have."""
    return any(_sticks_out(block, scope, first=not n) for n, block in enumerate(blocks))


def _sticks_out(block: Restriction, scope: Scope, *, first: bool) -> bool:
    if block.grants is not None:
        for grant in scope.grants:
            above = [g for g in block.grants if (g.object, g.operation) == (grant.object, grant.operation)]
            if not above or _grant_sticks_out(grant, above[0], whole=first):
                return True
    return (
        (block.ceiling is not None and scope.ceiling > block.ceiling)
        or any(block.audiences is not None and audience not in block.audiences for audience in scope.audiences)
        or any(block.delegates is not None and delegate not in block.delegates for delegate in scope.delegates)
        or (block.not_before is not None and scope.not_before < block.not_before)
        or (block.not_after is not None and scope.not_after > block.not_after)
    )


def _grant_sticks_out(grant: Grant, above: Grant, *, whole: bool) -> bool:
    """True where the grant has a value or pace that `above` lacks, or other parameters than the first block."""
    if whole and [limit.parameter for limit in grant.limits] != [limit.parameter for limit in above.limits]:
        return True
    if any(not any(_implies(tight, loose) for tight in grant.budgets) for loose in above.budgets):
        return True
    for limit in grant.limits:
        for stated in above.limits:
            if stated.parameter == limit.parameter and any(
                inside(limit.bound, point) and not inside(stated.bound, point)
                for point in points(limit.bound, stated.bound)
            ):
                return True
    return False


def less(blocks: Sequence[Restriction], scope: Scope) -> bool:
    """True where a scope lacks an operation, value, pace, tier, audience or delegate that all blocks have."""
    have = {(g.object, g.operation): g for g in scope.grants}
    for grant in blocks[0].grants or ():
        pair = grant.object, grant.operation
        if not all(b.grants is None or any((g.object, g.operation) == pair for g in b.grants) for b in blocks):
            continue
        if pair not in have:
            return True
        above = [each for b in blocks for g in b.grants or () if (g.object, g.operation) == pair for each in g.budgets]
        if any(not any(_implies(tight, loose) for tight in above) for loose in have[pair].budgets):
            return True
        for limit in have[pair].limits:
            bounds = stated(blocks, pair, limit.parameter)
            for point in points(limit.bound, *bounds):
                if all(inside(bound, point) for bound in bounds) and not inside(limit.bound, point):
                    return True
    return (
        all(block.ceiling is None or block.ceiling > scope.ceiling for block in blocks)
        or _lacks([block.audiences for block in blocks], scope.audiences)
        or _lacks([block.delegates for block in blocks], scope.delegates)
    )


def _lacks(above: Sequence[frozenset[str] | None], below: frozenset[str]) -> bool:
    everything = {member for members in above if members is not None for member in members}
    return any(
        member not in below and all(members is None or member in members for members in above) for member in everything
    )


def _implies(tight: Budget, loose: Budget) -> bool:
    """True where the fullest course of one budget, all of it at once again and again, is inside the other."""
    if tight.parameter != loose.parameter or tight.audience != loose.audience:
        return False
    return sum(tight.most for _ in range(0, loose.window_s, tight.window_s)) <= loose.most


# --- bounds ----------------------------------------------------------------------------------------------------------


def stated(blocks: Sequence[Restriction], pair: tuple[str, str], parameter: Parameter) -> list[Bound]:
    """Every bound that a block states for a parameter of an operation."""
    return [
        limit.bound
        for block in blocks
        for grant in block.grants or ()
        if (grant.object, grant.operation) == pair
        for limit in grant.limits
        if limit.parameter == parameter
    ]


def points(*bounds: Bound) -> list[Any]:
    """Every end, member and stem of the bounds, and the values just beside or after them."""
    some = [point for bound in bounds if not isinstance(bound, Each) for point in _points(bound)]
    lists = [bound for bound in bounds if isinstance(bound, Each)]
    elements = [bound.element for bound in lists if bound.element is not None]
    lengths = {near for each in lists for end in (each.least, each.most) for near in (end - 1, end, end + 1)}
    members = points(*elements) if elements else [0]
    return some + [(member,) * length for length in sorted(lengths) if length >= 0 for member in members]


def _points(bound: Range | OneOf | Flags | Words | Stems) -> Iterator[Any]:
    match bound:
        case Range(low, high):
            yield from (low - 1, low, low + 1, high - 1, high, high + 1)
        case OneOf(values):
            yield from (near for value in sorted(values) for near in (value - 1, value, value + 1))
        case Flags():
            yield from (False, True)
        case Words(values):
            yield from (near for word in sorted(values) for near in (word, f"{word}x", word[:-1]))
        case Stems(values, divider):
            for stem in sorted(values):
                yield from (stem, f"{stem}x", stem[:-1], f"{stem}{divider}x", f"{stem}{divider}~~")

"""Restriction of a delegation as a scenario states it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import msgspec

from capabilities.values.scope import Each, Grant, Limit, OneOf, Range, Restriction, Stems, Tier, Words
from capabilities.values.units import Parameter, Unit
from evaluation.redteam.desk.lending import rows
from ztpm.stage.lending import lent

if TYPE_CHECKING:
    from capabilities.values.scope import Bound, ScalarBound
    from evaluation.redteam.guarded import GuardedArena


class GrantTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One grant of a restriction.

    Attributes:
        object: the thing acted on.
        operation: on it.
        within: bound by parameter: `[low, high]`, or a table with `words`, `under`, `starts_with` or `one_of`; with
            `least` and `most` members beside it that of a list.
    """

    object: str
    operation: str
    within: dict[str, list[int] | dict[str, Any]] = {}


class Narrowing(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Restriction; what is left out stays as the parent has it.

    Attributes:
        grants: exactly those that stay.
        ceiling: highest tier.
        audiences: places, `arm` or `desk`.
        delegates: roles.
        depth: further hops.
        lasts_s: so long from now on.
        begins_s: not before that time from now on.
    """

    grants: tuple[GrantTable, ...] | None = None
    ceiling: int | None = None
    audiences: tuple[str, ...] | None = None
    delegates: tuple[str, ...] | None = None
    depth: int | None = None
    lasts_s: int | None = None
    begins_s: int | None = None


def restriction_of(arena: GuardedArena, stated: Narrowing) -> Restriction:
    """The restriction for agents and places of this cell."""
    now, named = int(time.time()), arena.cast.name
    parameters = _parameters(arena)
    grants = None
    if stated.grants is not None:
        found = (_grant(each, parameters) for each in stated.grants)
        grants = tuple(sorted(found, key=lambda each: (each.object, each.operation)))
    return Restriction(
        grants=grants,
        ceiling=None if stated.ceiling is None else Tier(stated.ceiling),
        audiences=None if stated.audiences is None else frozenset(map(arena.url, stated.audiences)),
        delegates=None if stated.delegates is None else frozenset(map(named, stated.delegates)),
        depth=stated.depth,
        not_before=None if stated.begins_s is None else now + stated.begins_s,
        not_after=None if stated.lasts_s is None else now + stated.lasts_s,
    )


def _parameters(arena: GuardedArena) -> dict[tuple[str, str], tuple[Parameter, ...]]:
    """Parameters of each operation of the arm and the desk, in their order."""
    known = {(g.object, g.operation): tuple(limit.parameter for limit in g.limits) for g in lent(arena.stage).grants}
    return known | {(row.object, row.name): tuple(each.parameter for each in row.limits) for row in rows().values()}


def _grant(stated: GrantTable, known: dict[tuple[str, str], tuple[Parameter, ...]]) -> Grant:
    order = known.get((stated.object, stated.operation), ())
    unknown = [Parameter(name, Unit.COUNT) for name in stated.within.keys() - {each.name for each in order}]
    limits = tuple(
        Limit(each, bound_of(stated.within[each.name])) for each in (*order, *unknown) if each.name in stated.within
    )
    return Grant(stated.object, stated.operation, limits)


def bound_of(stated: list[int] | dict[str, Any]) -> Bound:
    """The bound that a scenario states.

    Raises:
        ValueError: it is none.
    """
    if isinstance(stated, list):
        low, high = stated
        return Range(low, high)
    rest = dict(stated)
    least, most = rest.pop("least", None), rest.pop("most", None)
    ((how, values),) = rest.items()
    made: ScalarBound
    match how:
        case "words":
            made = Words(frozenset(values))
        case "under":
            made = Stems(frozenset(values), "/")
        case "starts_with":
            made = Stems(frozenset(values), "")
        case "one_of":
            made = OneOf(frozenset(values))
        case _:
            raise ValueError(f"no bound: {how}")
    return made if most is None else Each(made, least or 0, most)

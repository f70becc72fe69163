"""Declaration of facts that an act's tier depends on, beside the tool or in a table of TOML.

    @operation("press", base_tier=1, when={"zone-a/people": Fact(at_least={1: 3})})

says that the act is of tier 3 while sensor `zone-a` states one person or more, and also while it states nothing fresh.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Final

from capabilities.values import text as forms
from capabilities.values.scope import Range
from capabilities.values.units import INT_LIMIT, Unit
from pep.base.errors import DeclarationError, PepFault
from pep.base.stated_values import check_rows_raise, is_whole, tier_stated
from pep.base.tier_row import FactRow, TierRow

if TYPE_CHECKING:
    from capabilities.values.scope import Tier

FACTS: Final = 16
"""Most facts of one operation; ours: each is shown to people and recorded with every decision."""
FRESH_MS: Final = 500
"""Greatest age of a fact where none is stated (docs/physics.md PHY-8: an older view is unknown)."""
FRESH_MOST_MS: Final = 60_000
"""Greatest age that may be stated; ours: what was so a minute ago says nothing about now."""
_SENSOR: Final = re.compile(forms.REGISTERED, re.ASCII)
_NAME: Final = re.compile(forms.OPERATION, re.ASCII)


@dataclass(frozen=True, slots=True)
class Fact:
    """Values of a sensor's fact that raise the tier of an act.

    Attributes:
        at_least: tier of an act while the fact is so much or more, by value.
        at_most: tier of an act while the fact is so much or less, by value.
        unit: of the values, as `capabilities.values.units` spells it.
        fresh_ms: greatest age of the fact, in milliseconds; an older one counts as one that nobody stated.
    """

    at_least: Mapping[int, int] = field(default_factory=dict)
    at_most: Mapping[int, int] = field(default_factory=dict)
    unit: str = "count"
    fresh_ms: int = FRESH_MS


def fact_rows(place: str, stated: object, *, base_tier: Tier) -> tuple[FactRow, ...]:
    """The rows of an operation's facts, in the order of their names.

    Args:
        place: the operation, for errors.
        stated: `Fact`, or its members as a table of TOML has them, by "SENSOR/NAME".
        base_tier: of the operation; each row is above it.

    Raises:
        DeclarationError: naming the fact and its member.
    """
    if not isinstance(stated, Mapping) or len(stated) > FACTS:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: at most {FACTS} facts by SENSOR/NAME")
    return tuple(_row(f"{place}.{name}", name, stated[name], base_tier) for name in sorted(stated, key=str))


def _row(place: str, name: object, stated: object, base_tier: Tier) -> FactRow:
    sensor, slash, fact = str(name).partition("/")
    if not slash or _SENSOR.fullmatch(sensor) is None or _NAME.fullmatch(fact) is None:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: a fact is SENSOR/NAME, such as zone-a/people")
    of = stated if isinstance(stated, Fact) else _from_toml(place, stated)
    try:
        unit = Unit(of.unit)
    except ValueError as error:
        raise DeclarationError(PepFault.UNIT_UNKNOWN, f"{place}: {of.unit!r}") from error
    if not is_whole(of.fresh_ms) or not 1 <= of.fresh_ms <= FRESH_MOST_MS:
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}.fresh_ms: 1 to {FRESH_MOST_MS} ms")
    if not of.at_least and not of.at_most:
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: neither at_least nor at_most")
    upper = [TierRow(Range(at, INT_LIMIT), to) for at, to in _edges(f"{place}.at_least", of.at_least)]
    lower = [TierRow(Range(-INT_LIMIT, at), to) for at, to in _edges(f"{place}.at_most", of.at_most)]
    check_rows_raise(place, base_tier, upper, lower)
    return FactRow(sensor, fact, unit, of.fresh_ms, (*upper, *lower))


def _edges(place: str, stated: object) -> list[tuple[int, Tier]]:
    """Pairs of value and tier, ascending by value."""
    if not isinstance(stated, Mapping):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: tiers by value")
    for at in stated:
        if not is_whole(at) or not -INT_LIMIT <= at <= INT_LIMIT:
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {at!r} is no integer")
    return [(at, tier_stated(to, place)) for at, to in sorted(stated.items())]


def _from_toml(place: str, stated: object) -> Fact:
    members = {each.name for each in fields(Fact)}
    if not isinstance(stated, Mapping) or not set(stated) <= members:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: members are {', '.join(sorted(members))}")
    try:
        edges = {
            side: {int(at): to for at, to in stated[side].items()} for side in ("at_least", "at_most") if side in stated
        }
    except (AttributeError, ValueError, TypeError) as error:
        raise DeclarationError(
            PepFault.DECLARATION_MALFORMED, f"{place}: tiers by value, such as {{ 1 = 3 }}"
        ) from error
    return Fact(**{**stated, **edges})

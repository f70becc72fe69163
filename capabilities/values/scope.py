"""Scope of a token as a value; the order and the meet are in `capabilities.values.algebra`.

A scope has eight dimensions: grants, limits per parameter, budgets, tier ceiling, audience, delegates, depth and time
window. All numbers are integers (capabilities.values.units), all words canonical (capabilities.values.text). One
meaning has one value: docs/spec.md 1.2 says which.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, TypeAlias

from capabilities.values.fast_dataclass import maker
from capabilities.values.units import Kind, Parameter  # noqa: TC001 - dataclass fields: their annotations must resolve

_set: Final = object.__setattr__
"""Setter that completes a frozen value, once."""


class Tier(IntEnum):
    """Physical Impact Tier (PIT)."""

    NO_EFFECT = 0
    REVERSIBLE = 1
    CONSEQUENTIAL = 2
    HIGH_CONSEQUENCE = 3
    SAFETY_CRITICAL = 4


_TIERS: Final = {int(each): each for each in Tier}


def tier(number: int) -> Tier:
    """The tier of this number, found sooner than by calling the class.

    Raises:
        ValueError: when there is none.
    """
    found = _TIERS.get(number)
    if found is None:
        raise ValueError("not a tier")
    return found


@dataclass(frozen=True, slots=True)
class Range:
    """All integers from `low` to `high`, both included. Two-sided: an upper bound alone would admit every negative."""

    low: int
    high: int


@dataclass(frozen=True, slots=True)
class OneOf:
    """Exactly these integers, which are not consecutive: those are a `Range` (`capabilities.values.bounds.one_of`)."""

    values: frozenset[int]


@dataclass(frozen=True, slots=True)
class Flags:
    """Exactly these truth values, of a flag: one, or both."""

    values: frozenset[bool]


@dataclass(frozen=True, slots=True)
class Words:
    """Exactly these texts, paths or URLs."""

    values: frozenset[str]


@dataclass(frozen=True, slots=True)
class Stems:
    """Every word that is one of these stems or goes on after it; no stem goes on after another.

    The empty stem stands for all words.

    Attributes:
        values: texts, directories, or URLs: origins and what lies below them.
        divider: what stands between a stem and the rest: nothing in a text, a slash in paths and URLs.
    """

    values: frozenset[str]
    divider: str


ScalarBound: TypeAlias = Range | OneOf | Flags | Words | Stems
"""Bound of one value. That of a free value is a range of its size in bytes, from 1."""


@dataclass(frozen=True, slots=True)
class Each:
    """Every list of `least` to `most` members, each inside `element`; without `element` the empty list alone."""

    element: ScalarBound | None
    least: int
    most: int


Bound: TypeAlias = Range | OneOf | Flags | Words | Stems | Each


@dataclass(frozen=True, slots=True)
class Limit:
    """The bound of one parameter of one operation."""

    parameter: Parameter
    bound: Bound


@dataclass(frozen=True, slots=True, order=True)
class Budget:
    """Budget of one grant at one point: the most acts, or the most of a quantity, in any window.

    Attributes:
        parameter: the quantity that is counted, in its unit; "" counts acts.
        audience: canonical URL of the point that counts.
        window_s: length of every window, seconds.
        most: highest sum in any window, from 1.
    """

    parameter: str
    audience: str
    window_s: int
    most: int


@dataclass(frozen=True, slots=True)
class Grant:
    """One (object, operation) pair with the limits of all its parameters, in the operation's order, and its budgets.

    The limits are the operation's signature: a request must give exactly these parameters, each inside its bound.
    Without budgets there may be any number of requests; in a restriction, the parent's are kept.
    """

    object: str
    operation: str
    limits: tuple[Limit, ...] = ()
    budgets: tuple[Budget, ...] = ()
    _hash: int = field(default=0, init=False, repr=False, compare=False)

    def __hash__(self) -> int:
        # Computed once: memories about grants look them up by it.
        if not self._hash:
            object.__setattr__(self, "_hash", hash((self.object, self.operation, self.limits, self.budgets)) or 1)
        return self._hash

    def __reduce__(self) -> tuple[type[Grant], tuple[str, str, tuple[Limit, ...], tuple[Budget, ...]]]:
        # Without the hash, which another process computes differently.
        return Grant, (self.object, self.operation, self.limits, self.budgets)


@dataclass(frozen=True, slots=True)
class Scope:
    """Scope: the whole of the authority in a token.

    Attributes:
        grants: sorted by (object, operation), each pair once.
        ceiling: highest tier that any request under this scope may reach.
        audiences: canonical URLs of the servers that may accept the token.
        delegates: who may receive the next hop: agent ids, or `role:NAME`. Empty means nobody.
        depth: how many further hops may follow.
        not_before, not_after: seconds since the epoch; a request is inside when not_before <= at < not_after.
    """

    grants: tuple[Grant, ...]
    ceiling: Tier
    audiences: frozenset[str]
    delegates: frozenset[str]
    depth: int
    not_before: int
    not_after: int
    _by_pair: dict[tuple[str, str], Grant] | None = field(default=None, init=False, repr=False, compare=False)

    def find(self, object: str, operation: str) -> Grant | None:  # noqa: A002 - the word of the profile
        """Grant of a pair, or None.

        The table of the pairs is made once, when it is first asked for.
        """
        known = self._by_pair
        if known is None:
            # Set in one call, so that no other thread sees half of it.
            known = {(grant.object, grant.operation): grant for grant in self.grants}
            _set(self, "_by_pair", known)
        return known.get((object, operation))


@dataclass(frozen=True, slots=True)
class Restriction:
    """Restriction by one hop; None keeps the parent's dimension as it is.

    Attributes:
        grants: exactly the grants that stay; each names a pair of the parent, only
            those limits that it tightens, and all its budgets where it tightens them.
        ceiling, audiences, delegates, depth, not_before, not_after: as in `Scope`.
    """

    grants: tuple[Grant, ...] | None = None
    ceiling: Tier | None = None
    audiences: frozenset[str] | None = None
    delegates: frozenset[str] | None = None
    depth: int | None = None
    not_before: int | None = None
    not_after: int | None = None


make_scope: Final = maker(Scope)
make_restriction: Final = maker(Restriction)


@dataclass(frozen=True, slots=True)
class Widening:
    """One place where a child has more than its parent.

    Attributes:
        dimension: "grants", "limits", "budgets", "ceiling", "audiences", "delegates", "depth" or "window".
        what: the grant or parameter concerned, e.g. "ur3e/move_joint/speed".
        parent, child: the two bounds as plain JSON values.
        nearest: the nearest allowed value in the same form: the meet of the two bounds, or, where they have
            nothing in common, the one permitted value nearest to the wanted one. None when nothing is permitted.
        kind: of the values of a limit.
    """

    dimension: str
    what: str
    parent: object
    child: object
    nearest: object = None
    kind: Kind | None = None

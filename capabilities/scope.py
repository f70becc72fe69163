"""What a token allows, as values, and the partial order *narrows*.

A scope has seven dimensions: grants, limits per parameter, tier ceiling, audience, delegates, depth and time window.
Scopes form a meet-semilattice: the scope of a chain is the meet of its blocks, and a hop must be strictly below its
parent in grants, limits, ceiling, audience or delegates. All numbers are integers (capabilities.units).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from capabilities.units import Parameter  # noqa: TC001 - a dataclass field: its annotation must resolve


class Tier(IntEnum):
    """Physical Impact Tier (PIT)."""

    NO_EFFECT = 0
    REVERSIBLE = 1
    CONSEQUENTIAL = 2
    HIGH_CONSEQUENCE = 3
    SAFETY_CRITICAL = 4


@dataclass(frozen=True, slots=True)
class Range:
    """All integers from `low` to `high`, both included. Two-sided: an upper bound alone would admit every negative."""

    low: int
    high: int


@dataclass(frozen=True, slots=True)
class OneOf:
    """Exactly these integers."""

    values: frozenset[int]


Bound = Range | OneOf


@dataclass(frozen=True, slots=True)
class Limit:
    """The bound of one parameter of one operation."""

    parameter: Parameter
    bound: Bound


@dataclass(frozen=True, slots=True)
class Grant:
    """One (object, operation) pair with the limits of all its parameters, in the operation's order.

    The limits are the operation's signature: a request must give exactly these parameters, each inside its bound.
    """

    object: str
    operation: str
    limits: tuple[Limit, ...] = ()


@dataclass(frozen=True, slots=True)
class Scope:
    """The whole of what a token allows.

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


@dataclass(frozen=True, slots=True)
class Restriction:
    """What one hop takes away. None keeps the parent's dimension as it is.

    Attributes:
        grants: exactly the grants that stay; each names a pair of the parent and only those limits that it tightens.
        ceiling, audiences, delegates, depth, not_before, not_after: as in `Scope`.
    """

    grants: tuple[Grant, ...] | None = None
    ceiling: Tier | None = None
    audiences: frozenset[str] | None = None
    delegates: frozenset[str] | None = None
    depth: int | None = None
    not_before: int | None = None
    not_after: int | None = None


@dataclass(frozen=True, slots=True)
class Widening:
    """One place where a child has more than its parent.

    Attributes:
        dimension: "grants", "limits", "ceiling", "audiences", "delegates", "depth" or "window".
        what: the grant or parameter concerned, e.g. "ur3e/move_joint/speed".
        parent, child: the two bounds as plain JSON values.
    """

    dimension: str
    what: str
    parent: object
    child: object

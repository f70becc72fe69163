"""Scope around the acts of one agent that were permitted, as a journal or ledger has them. Pure.

What was observed is not what is needed: a rare act may be missing, and a needless one may be among them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from capabilities.values.arguments import kind_given, measured
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Grant, Limit, Scope, Tier
from capabilities.values.units import Parameter
from capabilities.values.well_formed import well_formed
from pep.mcp.discovery.observed_bound import observed_bound, widens
from policies.evidence.model import Effect

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from policies.evidence.model import Request

LIFETIME_S: Final = 900
"""Ours: length of the proposed window, which `ztpm token issue --minutes` moves to now."""
WIDE: Final = "every word passes: those on record begin alike in nothing"
Signature: TypeAlias = tuple[Parameter, ...]


@dataclass(frozen=True, slots=True)
class ObservedAct:
    """One decision on record.

    Attributes:
        request: that was decided.
        effect, reason: of the decision.
        tier: that it was decided at; None where none was found.
        at_ms: when, milliseconds since the epoch.
    """

    request: Request
    effect: Effect
    reason: str
    tier: Tier | None
    at_ms: int


@dataclass(frozen=True, slots=True)
class ObservedGrant:
    """One proposed grant, and the acts that it rests on.

    Attributes:
        grant: proposed.
        acts: number of permitted acts.
        highest: tier of the highest of them.
        first_ms, last_ms: when the first and the last was, milliseconds since the epoch.
        review: what a person has to look at.
    """

    grant: Grant
    acts: int
    highest: Tier
    first_ms: int
    last_ms: int
    review: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NotIncluded:
    """Acts on record that no proposed grant is for.

    Attributes:
        object, operation: of them.
        why: effect and reason, such as "DENY LIMIT_EXCEEDED_BY_REQUEST".
        acts: number of them.
    """

    object: str
    operation: str
    why: str
    acts: int


@dataclass(frozen=True, slots=True)
class ObservedScope:
    """Proposed scope with what it rests on.

    Attributes:
        scope: proposed; None where no act was permitted.
        grants: of it, in its order.
        not_included: other acts, the most frequent first.
    """

    scope: Scope | None
    grants: tuple[ObservedGrant, ...] = ()
    not_included: tuple[NotIncluded, ...] = ()


def observed_scope(acts: Iterable[ObservedAct]) -> ObservedScope:
    """The least scope of our forms in which every permitted act on record is, and no room for delegates.

    Args:
        acts: decisions about the requests of one agent, in any order.
    """
    permitted: dict[tuple[str, str], dict[Signature, list[ObservedAct]]] = {}
    others: Counter[tuple[str, str, str]] = Counter()
    for act in acts:
        pair = (act.request.object, act.request.operation)
        if act.effect is Effect.PERMIT and act.tier is not None:
            permitted.setdefault(pair, {}).setdefault(_signature(act.request), []).append(act)
        else:
            others[*pair, f"{act.effect} {act.reason}"] += 1
    grants: list[ObservedGrant] = []
    audiences: set[str] = set()
    for pair in sorted(permitted):
        # Of an operation whose parameters changed, only requests of the newest form can be granted.
        by_age = sorted(permitted[pair].values(), key=lambda each: max(act.at_ms for act in each))
        for older in by_age[:-1]:
            others[*pair, "other parameters than its newest acts have"] += len(older)
        grants.append(_grant(pair, by_age[-1]))
        audiences |= {act.request.audience for act in by_age[-1]}
    busiest = sorted(grants, key=lambda each: -each.acts)
    for left in busiest[CAPS.grants :]:
        others[left.grant.object, left.grant.operation, f"more than {CAPS.grants} grants"] += left.acts
    kept = tuple(each for each in grants if each in busiest[: CAPS.grants])
    told = tuple(
        NotIncluded(*key, count) for key, count in sorted(others.items(), key=lambda each: (-each[1], each[0]))
    )
    if not kept:
        return ObservedScope(None, not_included=told)
    scope = Scope(
        grants=tuple(each.grant for each in kept),
        ceiling=max(each.highest for each in kept),
        audiences=frozenset(audiences),
        delegates=frozenset(),
        depth=0,
        not_before=0,
        not_after=LIFETIME_S,
    )
    return ObservedScope(well_formed(scope, CAPS), kept, told)


def _signature(request: Request) -> Signature:
    return tuple(Parameter(value.name, kind_given(value)) for value in request.values)


def _grant(pair: tuple[str, str], acts: Sequence[ObservedAct]) -> ObservedGrant:
    limits: list[Limit] = []
    review: list[str] = []
    for place, parameter in enumerate(_signature(acts[0].request)):
        bound = observed_bound(parameter, [measured(act.request.values[place]) for act in acts])
        limits.append(Limit(parameter, bound))
        if widens(bound):
            review.append(f"{parameter.name}: {WIDE}")
    times = [act.at_ms for act in acts]
    highest = max(act.tier for act in acts if act.tier is not None)
    if len(acts) == 1:
        review.append("of one act alone")
    return ObservedGrant(Grant(*pair, tuple(limits)), len(acts), highest, min(times), max(times), tuple(review))

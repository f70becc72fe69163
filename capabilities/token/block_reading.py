"""Block of a token as it is read back, from its fact and the checks that its Datalog makes."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, TypeVar

from capabilities.token import fact as facts
from capabilities.token.block import ID_BYTES, AuthorityBlock, HopBlock, well_formed_first, well_formed_hop
from capabilities.token.checks import REMEMBERED, Alternative, Checks
from capabilities.values import algebra
from capabilities.values.chain import HopGrant, make_attestation, make_grant, make_sponsor
from capabilities.values.errors import CapabilityError, FaultCode, TokenError
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.scope import Budget, Grant, Limit, Restriction, Scope, make_restriction, make_scope, tier
from capabilities.values.units import Parameter, kind_of

if TYPE_CHECKING:
    from capabilities.token.fact import AuthorityStatement, BudgetRow, FactContent, HopStatement
    from capabilities.values.caps import Caps
    from capabilities.values.scope import Bound

_T = TypeVar("_T")


def authority_of(said: FactContent[AuthorityStatement], demanded: Checks, caps: Caps) -> AuthorityBlock:
    """The authority block that says and demands this.

    Raises:
        TokenError: `CHAIN_BROKEN` when there is no such block of the profile.
    """
    stated = said.statement
    try:
        by = stated.sponsor
        sponsor = make_sponsor(by.issuer, by.subject, by.method, by.authenticated_at)
        block = AuthorityBlock(
            token_id=stated.token,
            sponsor=sponsor,
            index=said.index,
            hop=_hop(said, sponsor.subject),
            scope=make_scope(
                grants=_whole_grants(_present(demanded.alternatives), bytes(stated.parameters), stated.budgets),
                ceiling=tier(_present(demanded.ceiling)),
                audiences=_ascending(stated.audiences),
                delegates=_ascending(stated.delegates),
                depth=stated.depth,
                not_before=_present(demanded.not_before),
                not_after=_present(demanded.not_after),
            ),
            mandate_id=stated.mandate,
        )
        well_formed_first(block, caps)
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not an authority block: {type(error).__name__}") from None
    return block


def hop_of(
    said: FactContent[HopStatement], demanded: Checks, *, index: int, delegator: str, parent: Scope, caps: Caps
) -> HopBlock:
    """Hop block of this statement and these demands, at this index, below a hop of `delegator` with scope `parent`.

    Raises:
        TokenError: `NOT_NARROWER` when it keeps an operation, or a number of parameters, that the parent does not have;
            `CHAIN_BROKEN` when there is no such block of the profile.
    """
    stated = said.statement
    try:
        hop = _hop(said, delegator)
        well_formed_hop(hop, caps)
        rest = make_restriction(
            ceiling=None if demanded.ceiling is None else tier(demanded.ceiling),
            audiences=None if stated.audiences is None else _ascending(stated.audiences),
            delegates=None if stated.delegates is None else _ascending(stated.delegates),
            depth=stated.depth,
            not_before=demanded.not_before,
            not_after=demanded.not_after,
        )
        algebra.well_formed_restriction(rest, caps)
        if said.index != index:
            raise TokenError(FaultCode.CHAIN_BROKEN, f"not the index of block {index}")
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not a hop block: {type(error).__name__}") from None
    if demanded.alternatives is None:
        if stated.budgets:
            raise TokenError(FaultCode.CHAIN_BROKEN, "budgets of no grant")
        return HopBlock(index, hop, rest)
    kept = _kept_grants(demanded.alternatives, parent.grants, stated.budgets)
    try:
        algebra.well_formed_grants(kept, caps)
    except CapabilityError as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not a hop block: {type(error).__name__}") from None
    return HopBlock(index, hop, _with_grants(rest, kept))


def _with_grants(rest: Restriction, grants: tuple[Grant, ...]) -> Restriction:
    return make_restriction(
        grants, rest.ceiling, rest.audiences, rest.delegates, rest.depth, rest.not_before, rest.not_after
    )


def _hop(said: FactContent[AuthorityStatement] | FactContent[HopStatement], delegator: str) -> HopGrant:
    hop_id, key, measurement, request_digest = said.raw
    if len(hop_id) != ID_BYTES:
        raise ValueError(f"a hop id that is not {ID_BYTES} bytes")
    stated = said.statement
    return make_grant(
        hop_id.hex(),
        stated.agent,
        key,
        delegator,
        stated.purpose,
        request_digest,
        make_attestation(stated.evidence, measurement, stated.at),
        stated.role,
    )


def _ascending(texts: tuple[str, ...]) -> frozenset[str]:
    """The members of a list of texts in ascending order, each once."""
    members = frozenset(texts)
    if list(texts) != sorted(members):
        raise ValueError("a list out of order, or with a member twice")
    return members


# Results of reading checks are remembered: a renewed token has the same checks, and so has the next agent's.


@functools.lru_cache(maxsize=REMEMBERED)
def _whole_grants(
    alternatives: tuple[Alternative, ...], spelled: bytes, rows: tuple[BudgetRow, ...]
) -> tuple[Grant, ...]:
    """Grants of a first block: those that its check keeps, under the names and kinds that its statement spells."""
    parameters, budgets = facts.parameters_of(spelled), _budgets(rows, len(alternatives))
    return HashedTuple(
        Grant(
            kept.object,
            kept.operation,
            tuple(_limit(name, bound) for name, bound in zip(names, kept.bounds, strict=True)),
            some,
        )
        for kept, names, some in zip(alternatives, parameters, budgets, strict=True)
    )


def _budgets(rows: tuple[BudgetRow, ...], grants: int) -> list[tuple[Budget, ...]]:
    """Budgets of each grant, from rows in ascending order.

    Raises:
        TokenError: `CHAIN_BROKEN` for rows in another order, or of no grant.
    """
    found: list[list[Budget]] = [[] for _ in range(grants)]
    if list(rows) != sorted(rows) or not all(0 <= row[0] < grants for row in rows):
        raise TokenError(FaultCode.CHAIN_BROKEN, "budgets out of order, or of no grant")
    for place, parameter, audience, window_s, most in rows:
        found[place].append(Budget(parameter, audience, window_s, most))
    return [tuple(some) for some in found]


def _limit(name: str, bound: Bound | None) -> Limit:
    if bound is None:
        raise ValueError("a parameter without bound")
    return Limit(_parameter(name), bound)


@functools.lru_cache(maxsize=REMEMBERED)
def _kept_grants(
    alternatives: tuple[Alternative, ...], parent: tuple[Grant, ...], rows: tuple[BudgetRow, ...]
) -> tuple[Grant, ...]:
    """Grants that a hop keeps, with the limits and budgets that it states, named as the parent names them."""
    known = {(grant.object, grant.operation): grant.limits for grant in parent}
    found = []
    for kept in alternatives:
        limits = known.get((kept.object, kept.operation))
        if limits is None or len(limits) != len(kept.bounds):
            raise TokenError(FaultCode.NOT_NARROWER, "keeps what the parent does not have")
        stated = zip(limits, kept.bounds, strict=True)
        found.append(
            Grant(
                kept.object,
                kept.operation,
                tuple(Limit(limit.parameter, bound) for limit, bound in stated if bound is not None),
            )
        )
    if not rows:
        return HashedTuple(found)
    budgets = _budgets(rows, len(found))
    return HashedTuple(
        Grant(grant.object, grant.operation, grant.limits, some) for grant, some in zip(found, budgets, strict=True)
    )


def _present(value: _T | None) -> _T:
    if value is None:
        raise ValueError("the authority block states every dimension")
    return value


def _parameter(value: str) -> Parameter:
    name, colon, kind = value.rpartition(":")
    if not colon:
        raise ValueError("a parameter without kind")
    return Parameter(name, kind_of(kind))

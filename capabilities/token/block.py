"""Block of a token as values, and as signed content: one fact and the checks that Datalog evaluates.

A block is written from values (`fact`, `checks`) and read back from its fact (capabilities.token.fact) and its
checks (capabilities.token.checks). The checks state grants, ceiling and window; the fact states all the
rest. Nothing is stated twice.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final, TypeVar, assert_never

import msgspec

from capabilities.keys import keys
from capabilities.statements.claims import ID
from capabilities.token import fact as facts
from capabilities.token.checks import REMEMBERED, Alternative, Checks
from capabilities.token.fact import PROFILE, AuthorityStatement, HopStatement, SponsorStatement
from capabilities.values import algebra, text
from capabilities.values.chain import HopGrant, Sponsor, make_attestation, make_grant, make_sponsor
from capabilities.values.errors import CapabilityError, FaultCode, TokenError
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.scope import Budget, Grant, Limit, Restriction, Scope, make_restriction, make_scope, tier
from capabilities.values.units import Parameter, kind_of

if TYPE_CHECKING:
    from capabilities.token.fact import BudgetRow, Fact, FactContent
    from capabilities.values.caps import Caps
    from capabilities.values.scope import Bound

_T = TypeVar("_T")

_DIGEST_BYTES: Final = 32
_ID_BYTES: Final = 16
"""16 bytes in the one spelling of base64url: of the last character two bits count, the spare ones are zero."""


class AuthorityBlock(msgspec.Struct, frozen=True):
    """The first block: who stands behind the token, its first holder and the whole scope.

    The holder's delegator is the sponsor's subject. `mandate_id` is that of the mandate that it was drawn from, if any.
    """

    token_id: str
    sponsor: Sponsor
    index: int
    hop: HopGrant
    scope: Scope
    mandate_id: str | None = None


class HopBlock(msgspec.Struct, frozen=True):
    """Further block of a token: a new holder, and the restriction of its scope.

    The holder's delegator is the agent of the hop before.
    """

    index: int
    hop: HopGrant
    restriction: Restriction


# --- writing ---------------------------------------------------------------------------------------------------------


def as_restriction(scope: Scope) -> Restriction:
    """The restriction that states every dimension of `scope`."""
    return Restriction(
        grants=scope.grants,
        ceiling=scope.ceiling,
        audiences=scope.audiences,
        delegates=scope.delegates,
        depth=scope.depth,
        not_before=scope.not_before,
        not_after=scope.not_after,
    )


def fact(block: AuthorityBlock | HopBlock) -> Fact:
    """The fact of a block."""
    hop = block.hop
    raw = bytes.fromhex(hop.hop_id), hop.key, hop.attestation.measurement, hop.request_digest
    return facts.written(block.index, raw, _statement(block))


def _statement(block: AuthorityBlock | HopBlock) -> AuthorityStatement | HopStatement:
    hop = block.hop
    match block:
        case AuthorityBlock(token_id, sponsor, _, _, scope, mandate_id):
            return AuthorityStatement(
                agent=hop.agent,
                at=hop.attestation.at,
                audiences=tuple(sorted(scope.audiences)),
                budgets=_rows(scope.grants),
                delegates=tuple(sorted(scope.delegates)),
                depth=scope.depth,
                evidence=hop.attestation.kind,
                mandate=mandate_id,
                parameters=facts.parameters_written(
                    tuple(
                        tuple(f"{limit.parameter.name}:{limit.parameter.kind}" for limit in grant.limits)
                        for grant in scope.grants
                    )
                ),
                profile=PROFILE,
                purpose=hop.purpose,
                role=hop.role,
                sponsor=SponsorStatement(
                    authenticated_at=sponsor.authenticated_at,
                    issuer=sponsor.issuer,
                    method=sponsor.method,
                    subject=sponsor.subject,
                ),
                token=token_id,
            )
        case HopBlock(_, _, restriction):
            return HopStatement(
                agent=hop.agent,
                at=hop.attestation.at,
                audiences=None if restriction.audiences is None else tuple(sorted(restriction.audiences)),
                budgets=_rows(restriction.grants or ()),
                delegates=None if restriction.delegates is None else tuple(sorted(restriction.delegates)),
                depth=restriction.depth,
                evidence=hop.attestation.kind,
                purpose=hop.purpose,
                role=hop.role,
            )
        case _:
            assert_never(block)


def _rows(grants: tuple[Grant, ...]) -> tuple[BudgetRow, ...]:
    """Budgets of grants, each with the number of its own."""
    return tuple(
        (place, each.parameter, each.audience, each.window_s, each.most)
        for place, grant in enumerate(grants)
        for each in grant.budgets
    )


def _stated(block: AuthorityBlock | HopBlock) -> Restriction:
    return as_restriction(block.scope) if isinstance(block, AuthorityBlock) else block.restriction


def checks(block: AuthorityBlock | HopBlock, parent: Scope | None) -> Checks:
    """Demands of the block's Datalog: its stated bounds, over the signatures of `parent` (None at hop 0)."""
    stated = _stated(block)
    alternatives = None
    if stated.grants is not None:
        signatures = (
            {} if parent is None else {(g.object, g.operation): [x.parameter for x in g.limits] for g in parent.grants}
        )
        alternatives = tuple(
            _alternative(grant, signatures.get((grant.object, grant.operation))) for grant in stated.grants
        )
    return Checks(
        alternatives=alternatives,
        not_before=stated.not_before,
        not_after=stated.not_after,
        ceiling=None if stated.ceiling is None else int(stated.ceiling),
    )


def _alternative(grant: Grant, signature: list[Parameter] | None) -> Alternative:
    bounds = {limit.parameter: limit.bound for limit in grant.limits}
    order = list(bounds) if signature is None else signature
    return Alternative(grant.object, grant.operation, tuple(bounds.get(parameter) for parameter in order))


# --- reading ---------------------------------------------------------------------------------------------------------


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
        _well_formed_first(block, caps)
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
        _well_formed_hop(hop, caps)
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
    if len(hop_id) != _ID_BYTES:
        raise ValueError(f"a hop id that is not {_ID_BYTES} bytes")
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


# --- the rules of the values -----------------------------------------------------------------------------------------


def well_formed(block: AuthorityBlock | HopBlock, caps: Caps) -> None:
    """Checks that every value of the block keeps the rules of the profile.

    Raises:
        CapabilityError: with the code of the fault.
    """
    match block:
        case AuthorityBlock():
            _well_formed_first(block, caps)
        case HopBlock():
            algebra.well_formed_restriction(block.restriction, caps)
            _well_formed_hop(block.hop, caps)
        case _:
            assert_never(block)
    if len(bytes.fromhex(block.hop.hop_id)) != _ID_BYTES or block.hop.hop_id != block.hop.hop_id.lower():
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a hop id is 32 hex digits")
    text.name(block.hop.delegator, most_bytes=caps.text_bytes)


def _well_formed_first(block: AuthorityBlock, caps: Caps) -> None:
    """Checks a block that was read: see `_well_formed_hop`."""
    if text.TOKEN_ID.fullmatch(block.token_id) is None:
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a token id is 16 bytes in base64url")
    if block.mandate_id is not None and ID.fullmatch(block.mandate_id) is None:
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a mandate id is 32 hex digits")
    sponsor, most = block.sponsor, caps.text_bytes
    text.url(sponsor.issuer, most_bytes=most)
    text.names((sponsor.subject, sponsor.method), most_bytes=most)
    _check_seconds(sponsor.authenticated_at)
    algebra.well_formed(block.scope, caps)
    _well_formed_hop(block.hop, caps)


def _well_formed_hop(hop: HopGrant, caps: Caps) -> None:
    """Checks the texts, key, digests and time of a hop that was read.

    Its id was written from bytes here, and its delegator is a name that was read before.
    """
    text.agent_id(hop.agent, most_bytes=caps.text_bytes)
    if hop.role:
        text.name(hop.role, most_bytes=caps.text_bytes - len(text.ROLE_PREFIX))
    text.prose(hop.purpose, most_bytes=caps.purpose_bytes)
    keys.check_raw(hop.key)
    attestation = hop.attestation
    if not len(hop.request_digest) == len(attestation.measurement) == _DIGEST_BYTES:
        raise ValueError(f"a digest that is not {_DIGEST_BYTES} bytes")
    _check_seconds(attestation.at)


def _present(value: _T | None) -> _T:
    if value is None:
        raise ValueError("the authority block states every dimension")
    return value


def _parameter(value: str) -> Parameter:
    name, colon, kind = value.rpartition(":")
    if not colon:
        raise ValueError("a parameter without kind")
    return Parameter(name, kind_of(kind))


def _check_seconds(value: int) -> None:
    if not 0 <= value < algebra.TIME_LIMIT:
        raise TokenError(FaultCode.OUT_OF_RANGE, "a time outside the calendar")

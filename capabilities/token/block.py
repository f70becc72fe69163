"""Block of a token as values, and as signed content: one fact and the checks that Datalog evaluates.

A block is written from values (`fact`, `checks`) and read back (capabilities.token.block_reading) from its fact
(capabilities.token.fact) and its checks (capabilities.token.checks). The checks state grants, ceiling and window; the
fact states all the rest. Nothing is stated twice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, assert_never

import msgspec

from capabilities.keys import keys
from capabilities.statements.claims import ID
from capabilities.token import fact as facts
from capabilities.token.checks import Alternative, Checks
from capabilities.token.fact import PROFILE, AuthorityStatement, HopStatement, SponsorStatement
from capabilities.values import algebra, text
from capabilities.values.chain import HopGrant, Sponsor
from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.scope import Grant, Restriction, Scope

if TYPE_CHECKING:
    from capabilities.token.fact import BudgetRow, Fact
    from capabilities.values.caps import Caps
    from capabilities.values.units import Parameter

_DIGEST_BYTES: Final = 32
ID_BYTES: Final = 16
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


# --- the rules of the values -----------------------------------------------------------------------------------------


def well_formed(block: AuthorityBlock | HopBlock, caps: Caps) -> None:
    """Checks that every value of the block keeps the rules of the profile.

    Raises:
        CapabilityError: with the code of the fault.
    """
    match block:
        case AuthorityBlock():
            well_formed_first(block, caps)
        case HopBlock():
            algebra.well_formed_restriction(block.restriction, caps)
            well_formed_hop(block.hop, caps)
        case _:
            assert_never(block)
    if len(bytes.fromhex(block.hop.hop_id)) != ID_BYTES or block.hop.hop_id != block.hop.hop_id.lower():
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a hop id is 32 hex digits")
    text.name(block.hop.delegator, most_bytes=caps.text_bytes)


def well_formed_first(block: AuthorityBlock, caps: Caps) -> None:
    """Checks a block that was read: see `well_formed_hop`."""
    if text.TOKEN_ID.fullmatch(block.token_id) is None:
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a token id is 16 bytes in base64url")
    if block.mandate_id is not None and ID.fullmatch(block.mandate_id) is None:
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a mandate id is 32 hex digits")
    sponsor, most = block.sponsor, caps.text_bytes
    text.url(sponsor.issuer, most_bytes=most)
    text.names((sponsor.subject, sponsor.method), most_bytes=most)
    _check_seconds(sponsor.authenticated_at)
    algebra.well_formed(block.scope, caps)
    well_formed_hop(block.hop, caps)


def well_formed_hop(hop: HopGrant, caps: Caps) -> None:
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


def _check_seconds(value: int) -> None:
    if not 0 <= value < algebra.TIME_LIMIT:
        raise TokenError(FaultCode.OUT_OF_RANGE, "a time outside the calendar")

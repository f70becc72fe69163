"""One block of a token as values, and as what is signed: one fact and the checks that Datalog evaluates.

A block is written from values (`fact`, `checks`) and read back from its contents (`authority_of`, `hop_of`). The checks
state grants, ceiling and window; the fact states all the rest: keys and digests as byte strings, and one canonical JSON
object. Nothing is stated twice.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Generic, TypeVar, assert_never

import msgspec

from capabilities import algebra, keys, text
from capabilities import checks as written
from capabilities.chain import Attestation, EvidenceKind, HopGrant, Sponsor
from capabilities.checks import REMEMBERED, Alternative, Checks
from capabilities.errors import CapabilityError, FaultCode, TokenError
from capabilities.scope import Grant, Limit, Restriction, Scope, Tier
from capabilities.units import Parameter, Unit

if TYPE_CHECKING:
    from capabilities.caps import Caps
    from capabilities.scope import Bound
    from capabilities.wire import Contents

_T = TypeVar("_T")

PROFILE: Final = "ztpm/1"
PREDICATE: Final = "hop"
"""The only fact of a block: ``hop(index, hop id, key, measurement, request digest, statement)``."""
BYTE_STRINGS: Final = 5
AUTHORITY_VERSION: Final = 3  # of a block's Datalog, as the Biscuit library writes it (schema.proto, Block.version)
HOP_VERSION: Final = 5
"""Third-party blocks, in the signature version that binds them to their place, have this one."""

_DIGEST_BYTES: Final = 32
_ID_BYTES: Final = 16


class SponsorStatement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Member `sponsor` of an authority block's statement."""

    authenticated_at: int
    issuer: str
    method: str
    subject: str


# Members stand in the order of RFC 8785, those at will have a default; written again, a statement gives the same bytes.


class HopStatement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The JSON object of a hop block."""

    agent: str
    at: int
    audiences: tuple[str, ...] | None = None
    delegates: tuple[str, ...] | None = None
    depth: int | None = None
    evidence: str
    purpose: str
    role: str = ""


class AuthorityStatement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The JSON object of an authority block."""

    agent: str
    at: int
    audiences: tuple[str, ...]
    delegates: tuple[str, ...]
    depth: int
    evidence: str
    parameters: tuple[tuple[str, ...], ...]
    profile: str
    purpose: str
    role: str = ""
    sponsor: SponsorStatement
    token: str


class _AnyProfile(msgspec.Struct):
    profile: object = None


_ENCODER: Final = msgspec.json.Encoder()
_PROFILE: Final = msgspec.json.Decoder(_AnyProfile)
_HOP: Final = msgspec.json.Decoder(HopStatement)
_AUTHORITY: Final = msgspec.json.Decoder(AuthorityStatement)


@dataclass(frozen=True, slots=True)
class AuthorityBlock:
    """The first block: who stands behind the token, its first holder and the whole scope.

    The holder's delegator is the sponsor's subject.
    """

    token_id: str
    sponsor: Sponsor
    index: int
    hop: HopGrant
    scope: Scope


@dataclass(frozen=True, slots=True)
class HopBlock:
    """A further block: a new holder and what is taken away. The holder's delegator is the agent of the hop before."""

    index: int
    hop: HopGrant
    restriction: Restriction


_S = TypeVar("_S", AuthorityStatement, HopStatement)


@dataclass(frozen=True, slots=True)
class Said(Generic[_S]):
    """What the fact of a block says: its index, its byte strings in order, its JSON object."""

    index: int
    raw: tuple[bytes, ...]
    statement: _S


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


def fact(block: AuthorityBlock | HopBlock) -> tuple[str, tuple[int | bytes, ...]]:
    """The fact of a block."""
    hop = block.hop
    return PREDICATE, (
        block.index,
        bytes.fromhex(hop.hop_id),
        hop.key,
        hop.attestation.measurement,
        hop.request_digest,
        _ENCODER.encode(_statement(block)),
    )


def _statement(block: AuthorityBlock | HopBlock) -> AuthorityStatement | HopStatement:
    hop = block.hop
    match block:
        case AuthorityBlock(token_id, sponsor, _, _, scope):
            return AuthorityStatement(
                agent=hop.agent,
                at=hop.attestation.at,
                audiences=tuple(sorted(scope.audiences)),
                delegates=tuple(sorted(scope.delegates)),
                depth=scope.depth,
                evidence=str(hop.attestation.kind),
                parameters=tuple(
                    tuple(f"{limit.parameter.name}:{limit.parameter.unit}" for limit in grant.limits)
                    for grant in scope.grants
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
                delegates=None if restriction.delegates is None else tuple(sorted(restriction.delegates)),
                depth=restriction.depth,
                evidence=str(hop.attestation.kind),
                purpose=hop.purpose,
                role=hop.role,
            )
        case _:
            assert_never(block)


def _stated(block: AuthorityBlock | HopBlock) -> Restriction:
    return as_restriction(block.scope) if isinstance(block, AuthorityBlock) else block.restriction


def checks(block: AuthorityBlock | HopBlock, parent: Scope | None) -> Checks:
    """What the block's Datalog demands: the bounds that it states, over the signatures of `parent` (None at hop 0)."""
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


def authority_said(contents: Contents) -> Said[AuthorityStatement]:
    """What the fact of an authority block says.

    Raises:
        TokenError: `WRONG_PROFILE` when the block is of another profile or version of Datalog, `CHAIN_BROKEN` when its
            fact is not that of the profile.
    """
    spelled = _spelled(contents, AUTHORITY_VERSION)
    try:
        profile = _PROFILE.decode(spelled).profile
    except ValueError:
        raise TokenError(FaultCode.CHAIN_BROKEN, "not a JSON object") from None
    if profile != PROFILE:
        raise TokenError(FaultCode.WRONG_PROFILE, f"not {PROFILE}")
    return _said(contents, _AUTHORITY)


def hop_said(contents: Contents) -> Said[HopStatement]:
    """What the fact of a hop block says.

    Raises:
        TokenError: as `authority_said`.
    """
    _spelled(contents, HOP_VERSION)
    return _said(contents, _HOP)


def _spelled(contents: Contents, version: int) -> bytes:
    """The JSON of a fact that has the form of the profile."""
    if contents.version != version:
        raise TokenError(FaultCode.WRONG_PROFILE, "a block of another version of Datalog")
    if written.text_of(contents.symbols, contents.predicate) != PREDICATE or len(contents.raw) != BYTE_STRINGS:
        raise TokenError(FaultCode.CHAIN_BROKEN, "a fact that no block of the profile has")
    return contents.raw[-1]


def _said(contents: Contents, decoder: msgspec.json.Decoder[_S]) -> Said[_S]:
    spelled = contents.raw[-1]
    try:
        statement = decoder.decode(spelled)
        again = _ENCODER.encode(statement)  # the same bytes: so no member was there twice, and none had its default
    except (ValueError, RecursionError):
        raise TokenError(FaultCode.CHAIN_BROKEN, "not a JSON object of the profile") from None
    if again != spelled:
        raise TokenError(FaultCode.CHAIN_BROKEN, "not the canonical JSON")
    return Said(contents.index, contents.raw[:-1], statement)


def authority_of(said: Said[AuthorityStatement], demanded: Checks, caps: Caps) -> AuthorityBlock:
    """The authority block that says and demands this.

    Raises:
        TokenError: `CHAIN_BROKEN` when there is no such block of the profile.
    """
    stated = said.statement
    try:
        sponsor = Sponsor(
            issuer=stated.sponsor.issuer,
            subject=stated.sponsor.subject,
            method=stated.sponsor.method,
            authenticated_at=stated.sponsor.authenticated_at,
        )
        block = AuthorityBlock(
            token_id=stated.token,
            sponsor=sponsor,
            index=said.index,
            hop=_hop(said, sponsor.subject),
            scope=Scope(
                grants=_whole_grants(_present(demanded.alternatives), stated.parameters),
                ceiling=Tier(_present(demanded.ceiling)),
                audiences=_ascending(stated.audiences),
                delegates=_ascending(stated.delegates),
                depth=stated.depth,
                not_before=_present(demanded.not_before),
                not_after=_present(demanded.not_after),
            ),
        )
        well_formed(block, caps)
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not an authority block: {type(error).__name__}") from None
    return block


def hop_of(said: Said[HopStatement], demanded: Checks, *, delegator: str, parent: Scope, caps: Caps) -> HopBlock:
    """The hop block that says and demands this, below a hop of agent `delegator` with the scope `parent`.

    Raises:
        TokenError: `NOT_NARROWER` when it keeps an operation, or a number of parameters, that the parent does not have;
            `CHAIN_BROKEN` when there is no such block of the profile.
    """
    stated = said.statement
    kept = None if demanded.alternatives is None else _kept_grants(demanded.alternatives, parent.grants)
    try:
        block = HopBlock(
            index=said.index,
            hop=_hop(said, delegator),
            restriction=Restriction(
                grants=kept,
                ceiling=None if demanded.ceiling is None else Tier(demanded.ceiling),
                audiences=None if stated.audiences is None else _ascending(stated.audiences),
                delegates=None if stated.delegates is None else _ascending(stated.delegates),
                depth=stated.depth,
                not_before=demanded.not_before,
                not_after=demanded.not_after,
            ),
        )
        well_formed(block, caps)
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not a hop block: {type(error).__name__}") from None
    return block


def _hop(said: Said[AuthorityStatement] | Said[HopStatement], delegator: str) -> HopGrant:
    hop_id, key, measurement, request_digest = said.raw
    stated = said.statement
    return HopGrant(
        hop_id=_exact(hop_id, _ID_BYTES).hex(),
        agent=stated.agent,
        key=key,
        delegator=delegator,
        purpose=stated.purpose,
        request_digest=request_digest,
        attestation=Attestation(EvidenceKind(stated.evidence), measurement, stated.at),
        role=stated.role,
    )


def _ascending(texts: tuple[str, ...]) -> frozenset[str]:
    """The members of a list of texts in ascending order, each once."""
    if list(texts) != sorted(set(texts)):
        raise ValueError("a list out of order, or with a member twice")
    return frozenset(texts)


# What is made of the checks is remembered: a renewed token has the same ones, and so has the next agent's.


@functools.lru_cache(maxsize=REMEMBERED)
def _whole_grants(alternatives: tuple[Alternative, ...], parameters: tuple[tuple[str, ...], ...]) -> tuple[Grant, ...]:
    """The grants of a first block: what its check keeps, under the names and units that it states beside."""
    return tuple(
        Grant(
            kept.object,
            kept.operation,
            tuple(_limit(name, bound) for name, bound in zip(names, kept.bounds, strict=True)),
        )
        for kept, names in zip(alternatives, parameters, strict=True)
    )


def _limit(name: str, bound: Bound | None) -> Limit:
    if bound is None:
        raise ValueError("a parameter without bound")
    return Limit(_parameter(name), bound)


@functools.lru_cache(maxsize=REMEMBERED)
def _kept_grants(alternatives: tuple[Alternative, ...], parent: tuple[Grant, ...]) -> tuple[Grant, ...]:
    """The grants that a hop keeps, each with the limits that it states, named as the parent names them."""
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
    return tuple(found)


# --- the rules of the values -----------------------------------------------------------------------------------------


def well_formed(block: AuthorityBlock | HopBlock, caps: Caps) -> None:
    """Pass when every value of the block keeps the rules of the profile.

    Raises:
        CapabilityError: with the code of what is wrong.
    """
    match block:
        case AuthorityBlock():
            if len(keys.unb64u(block.token_id)) != _ID_BYTES:
                raise TokenError(FaultCode.TOKEN_MALFORMED, "a token id is 16 bytes in base64url")
            text.url(block.sponsor.issuer, most_bytes=caps.text_bytes)
            text.name(block.sponsor.subject, most_bytes=caps.text_bytes)
            text.name(block.sponsor.method, most_bytes=caps.text_bytes)
            _seconds(block.sponsor.authenticated_at)
            algebra.well_formed(block.scope, caps)
        case HopBlock():
            algebra.well_formed_restriction(block.restriction, caps)
        case _:
            assert_never(block)
    _well_formed_hop(block.hop, caps)


def _well_formed_hop(hop: HopGrant, caps: Caps) -> None:
    if len(bytes.fromhex(hop.hop_id)) != _ID_BYTES or hop.hop_id != hop.hop_id.lower():
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a hop id is 32 hex digits")
    text.agent_id(hop.agent, most_bytes=caps.text_bytes)
    text.name(hop.delegator, most_bytes=caps.text_bytes)
    if hop.role:
        text.name(hop.role, most_bytes=caps.text_bytes - len(text.ROLE_PREFIX))
    text.prose(hop.purpose, most_bytes=caps.purpose_bytes)
    keys.check_raw(hop.key)
    _exact(hop.request_digest, _DIGEST_BYTES)
    _exact(hop.attestation.measurement, _DIGEST_BYTES)
    _seconds(hop.attestation.at)


def _present(value: _T | None) -> _T:
    if value is None:
        raise ValueError("the authority block states every dimension")
    return value


def _parameter(value: str) -> Parameter:
    name, colon, unit = value.rpartition(":")
    if not colon:
        raise ValueError("a parameter without unit")
    return Parameter(name, Unit(unit))


def _exact(raw: bytes, length: int) -> bytes:
    if len(raw) != length:
        raise ValueError(f"not {length} bytes")
    return raw


def _seconds(value: int) -> None:
    if not 0 <= value < algebra.TIME_LIMIT:
        raise TokenError(FaultCode.OUT_OF_RANGE, "a time outside the calendar")

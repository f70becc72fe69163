"""One block of a token as values, and as what is signed: one fact and the checks that Datalog evaluates.

A block is written from values (`fact`, `checks`) and read back from its contents (`authority_of`, `hop_of`). The checks
state grants, ceiling and window; the fact states all the rest: keys and digests as byte strings, and one canonical JSON
object. Nothing is stated twice.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar, assert_never

from capabilities import algebra, keys, text
from capabilities import checks as written
from capabilities.chain import Attestation, EvidenceKind, HopGrant, Sponsor
from capabilities.checks import REMEMBERED, Alternative, Checks
from capabilities.errors import CapabilityError, FaultCode, TokenError
from capabilities.scope import Grant, Limit, Restriction, Scope, Tier
from capabilities.units import Parameter, Unit

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.caps import Caps
    from capabilities.scope import Bound
    from capabilities.wire import Contents

_T = TypeVar("_T")

PROFILE: Final = "ztpm/1"
PREDICATE: Final = "hop"
"""The only fact of a block: ``hop(index, hop id, key, measurement, request digest, statement)``."""
TERMS: Final = 6
AUTHORITY_VERSION: Final = 3  # of a block's Datalog, as the Biscuit library writes it (schema.proto, Block.version)
HOP_VERSION: Final = 5
"""Third-party blocks, in the signature version that binds them to their place, have this one."""

_DIGEST_BYTES: Final = 32
_ID_BYTES: Final = 16
_HOP: Final = frozenset({"agent", "at", "evidence", "purpose"})
_AT_WILL: Final = frozenset({"role", "audiences", "delegates", "depth"})
_AUTHORITY: Final = _HOP | {"audiences", "delegates", "depth", "parameters", "profile", "sponsor", "token"}
_SPONSOR: Final = frozenset({"authenticated_at", "issuer", "method", "subject"})
_ENCODER: Final = json.JSONEncoder(ensure_ascii=False, allow_nan=False, sort_keys=True, separators=(",", ":"))
"""Writes RFC 8785 where members are ASCII and numbers are integers, as in every statement here."""


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


@dataclass(frozen=True, slots=True)
class Statement:
    """What the fact of a block says: its index, its byte strings in order, the members of its JSON object."""

    index: int
    raw: tuple[bytes, ...]
    members: Mapping[str, object]


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
    statement = _ENCODER.encode(_members(block)).encode()
    return PREDICATE, (
        block.index,
        bytes.fromhex(hop.hop_id),
        hop.key,
        hop.attestation.measurement,
        hop.request_digest,
        statement,
    )


def _members(block: AuthorityBlock | HopBlock) -> dict[str, object]:
    """What a block states in JSON."""
    hop, stated = block.hop, _stated(block)
    members: dict[str, object] = {
        "agent": hop.agent,
        "at": hop.attestation.at,
        "evidence": str(hop.attestation.kind),
        "purpose": hop.purpose,
    }
    if hop.role:
        members["role"] = hop.role
    if stated.audiences is not None:
        members["audiences"] = sorted(stated.audiences)
    if stated.delegates is not None:
        members["delegates"] = sorted(stated.delegates)
    if stated.depth is not None:
        members["depth"] = stated.depth
    match block:
        case AuthorityBlock(token_id, sponsor, _, _, scope):
            members |= {
                "profile": PROFILE,
                "token": token_id,
                "sponsor": {
                    "authenticated_at": sponsor.authenticated_at,
                    "issuer": sponsor.issuer,
                    "method": sponsor.method,
                    "subject": sponsor.subject,
                },
                "parameters": [
                    [f"{limit.parameter.name}:{limit.parameter.unit}" for limit in grant.limits]
                    for grant in scope.grants
                ],
            }
        case HopBlock():
            pass
        case _:
            assert_never(block)
    return members


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


def statement_of(contents: Contents, *, first: bool) -> Statement:
    """What the fact of a block says.

    Args:
        contents: of the block.
        first: whether it is the authority block.

    Raises:
        TokenError: `WRONG_PROFILE` when the block is of another profile or version of Datalog, `CHAIN_BROKEN` when its
            fact is not that of the profile.
    """
    if contents.version != (AUTHORITY_VERSION if first else HOP_VERSION):
        raise TokenError(FaultCode.WRONG_PROFILE, "a block of another version of Datalog")
    if written.text_of(contents.symbols, contents.predicate) != PREDICATE or len(contents.terms) != TERMS:
        raise TokenError(FaultCode.CHAIN_BROKEN, "a fact that no block of the profile has")
    index, *raw, spelled = contents.terms
    try:
        members = json.loads(spelled)
        again = _ENCODER.encode(members).encode()  # the same bytes: so no member was there twice
    except (ValueError, RecursionError):
        raise TokenError(FaultCode.CHAIN_BROKEN, "not JSON") from None
    if again != spelled or not isinstance(members, dict):
        raise TokenError(FaultCode.CHAIN_BROKEN, "not a canonical JSON object")
    if first and members.get("profile") != PROFILE:
        raise TokenError(FaultCode.WRONG_PROFILE, f"not {PROFILE}")
    return Statement(index, tuple(raw), members)


def authority_of(stated: Statement, demanded: Checks, caps: Caps) -> AuthorityBlock:
    """The authority block that states and demands this.

    Raises:
        TokenError: `CHAIN_BROKEN` when there is no such block of the profile.
    """
    members = stated.members
    try:
        _closed(members, _AUTHORITY, _AUTHORITY | {"role"})
        person = _closed(members["sponsor"], _SPONSOR, _SPONSOR)
        sponsor = Sponsor(
            issuer=_text(person["issuer"]),
            subject=_text(person["subject"]),
            method=_text(person["method"]),
            authenticated_at=_int(person["authenticated_at"]),
        )
        block = AuthorityBlock(
            token_id=_text(members["token"]),
            sponsor=sponsor,
            index=stated.index,
            hop=_hop(stated, sponsor.subject),
            scope=Scope(
                grants=_whole_grants(_present(demanded.alternatives), _parameters(members["parameters"])),
                ceiling=Tier(_present(demanded.ceiling)),
                audiences=_texts(members["audiences"]),
                delegates=_texts(members["delegates"]),
                depth=_int(members["depth"]),
                not_before=_present(demanded.not_before),
                not_after=_present(demanded.not_after),
            ),
        )
        well_formed(block, caps)
    except (ValueError, KeyError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not an authority block: {type(error).__name__}") from None
    return block


def hop_of(stated: Statement, demanded: Checks, *, delegator: str, parent: Scope, caps: Caps) -> HopBlock:
    """The hop block that states and demands this, below a hop of agent `delegator` with the scope `parent`.

    Raises:
        TokenError: `NOT_NARROWER` when it keeps an operation, or a number of parameters, that the parent does not have;
            `CHAIN_BROKEN` when there is no such block of the profile.
    """
    members = stated.members
    kept = None if demanded.alternatives is None else _kept_grants(demanded.alternatives, parent.grants)
    try:
        _closed(members, _HOP, _HOP | _AT_WILL)
        block = HopBlock(
            index=stated.index,
            hop=_hop(stated, delegator),
            restriction=Restriction(
                grants=kept,
                ceiling=None if demanded.ceiling is None else Tier(demanded.ceiling),
                audiences=_texts(members["audiences"]) if "audiences" in members else None,
                delegates=_texts(members["delegates"]) if "delegates" in members else None,
                depth=_int(members["depth"]) if "depth" in members else None,
                not_before=demanded.not_before,
                not_after=demanded.not_after,
            ),
        )
        well_formed(block, caps)
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not a hop block: {type(error).__name__}") from None
    return block


def _hop(stated: Statement, delegator: str) -> HopGrant:
    members = stated.members
    hop_id, key, measurement, request_digest = stated.raw
    return HopGrant(
        hop_id=_exact(hop_id, _ID_BYTES).hex(),
        agent=_text(members["agent"]),
        key=key,
        delegator=delegator,
        purpose=_text(members["purpose"]),
        request_digest=request_digest,
        attestation=Attestation(EvidenceKind(_text(members["evidence"])), measurement, _int(members["at"])),
        role=_role(members["role"]) if "role" in members else "",
    )


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


def _parameters(value: object) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(map(_text, _list(some))) for some in _list(value))


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


def _closed(value: object, least: frozenset[str], most: frozenset[str]) -> Mapping[str, object]:
    if not isinstance(value, dict) or not least <= value.keys() <= most:
        raise ValueError("not the members of the profile")
    return value


def _present(value: _T | None) -> _T:
    if value is None:
        raise ValueError("the authority block states every dimension")
    return value


def _int(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("not an integer")  # noqa: TRY004 - a wrong term is wrong input, not a wrong call
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError("not a text")  # noqa: TRY004 - as above
    return value


def _list(value: object) -> list[object]:
    if not isinstance(value, list):
        raise ValueError("not a list")  # noqa: TRY004 - as above
    return value


def _texts(value: object) -> frozenset[str]:
    """The members of a list of texts in ascending order, each once."""
    found = [_text(each) for each in _list(value)]
    if found != sorted(set(found)):
        raise ValueError("a list out of order, or with a member twice")
    return frozenset(found)


def _role(value: object) -> str:
    if not (role := _text(value)):
        raise ValueError("an empty role is not stated")
    return role


def _parameter(value: object) -> Parameter:
    name, colon, unit = _text(value).rpartition(":")
    if not colon:
        raise ValueError("a parameter without unit")
    return Parameter(name, Unit(unit))


def _exact(raw: bytes, length: int) -> bytes:
    if len(raw) != length:
        raise ValueError(f"not {length} bytes")
    return raw


def _seconds(value: object) -> None:
    if not 0 <= _int(value) < algebra.TIME_LIMIT:
        raise TokenError(FaultCode.OUT_OF_RANGE, "a time outside the calendar")

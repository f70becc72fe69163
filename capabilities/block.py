"""One block of a token as values, as typed facts, and as the checks that Datalog evaluates.

A block is written from values (`rows`, `checks`) and read back from its facts (`authority_from_rows`, `hop_from_rows`).
Reading is strict in one move: what was understood is written again, and the rows must be the very same ones, each once.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar, assert_never

from capabilities import algebra, keys, text
from capabilities.chain import Attestation, EvidenceKind, HopGrant, Sponsor
from capabilities.errors import CapabilityError, FaultCode, TokenError
from capabilities.scope import Bound, Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.units import Parameter, Unit

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from capabilities.caps import Caps

PROFILE: Final = "ztpm/1"

Term = int | str | bytes
Row = tuple[str, tuple[Term, ...]]
"""One fact: its predicate and its terms."""

ARITY: Final[dict[str, int]] = {
    "token": 2,  # profile, token id
    "sponsor": 4,  # issuer, subject, method, authenticated at
    # index, hop id, agent, role, key, delegator, its key's thumbprint, purpose, request digest, kind, measurement, at
    "hop": 12,
    "bound": 3,  # index, dimension, value or count
    "member": 4,  # index, dimension, ordinal, text
    "grant": 5,  # index, grant, object, operation, how many parameters are bounded here
    "limit": 7,  # index, grant, parameter, name, unit, low, high
    "choice": 7,  # index, grant, parameter, name, unit, ordinal, value
}
"""Every predicate of the profile. No other may occur in a block."""
AUTHORITY_ONLY: Final = frozenset({"token", "sponsor"})

_DIGEST_BYTES: Final = 32
_ID_BYTES: Final = 16


@dataclass(frozen=True, slots=True)
class HopFacts:
    """What a block states about its holder: see `capabilities.chain.Hop`. `delegator_thumbprint` is empty at hop 0."""

    index: int
    grant: HopGrant
    delegator_thumbprint: bytes


@dataclass(frozen=True, slots=True)
class AuthorityBlock:
    """The first block: who stands behind the token, its first holder and the whole scope."""

    token_id: str
    sponsor: Sponsor
    hop: HopFacts
    scope: Scope


@dataclass(frozen=True, slots=True)
class HopBlock:
    """A further block: a new holder and what is taken away."""

    hop: HopFacts
    restriction: Restriction


@dataclass(frozen=True, slots=True)
class Alternative:
    """One operation that a block keeps: ``req(object, operation, v0 .. vn)`` with the bounds that the block states."""

    object: str
    operation: str
    bounds: tuple[Bound | None, ...]


@dataclass(frozen=True, slots=True)
class Checks:
    """What a block demands of a request: one of the alternatives, a time and a base tier. None demands nothing."""

    alternatives: tuple[Alternative, ...] | None
    not_before: int | None
    not_after: int | None
    ceiling: int | None

    @property
    def count(self) -> int:
        """How many `check` statements this compiles to."""
        contextual = (self.not_before, self.not_after, self.ceiling) != (None, None, None)
        return (self.alternatives is not None) + contextual


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


def rows(block: AuthorityBlock | HopBlock) -> tuple[Row, ...]:
    """The typed facts of a block, in the order of the specification."""
    both: tuple[Row, ...] = (("hop", _hop_terms(block.hop)), *_restriction_rows(block.hop.index, _stated(block)))
    match block:
        case AuthorityBlock(token_id, sponsor):
            person = (sponsor.issuer, sponsor.subject, sponsor.method, sponsor.authenticated_at)
            return (("token", (PROFILE, keys.unb64u(token_id))), ("sponsor", person), *both)
        case HopBlock():
            return both
        case _:
            assert_never(block)


def _stated(block: AuthorityBlock | HopBlock) -> Restriction:
    return as_restriction(block.scope) if isinstance(block, AuthorityBlock) else block.restriction


def _hop_terms(hop: HopFacts) -> tuple[Term, ...]:
    grant, attestation = hop.grant, hop.grant.attestation
    return (
        hop.index,
        bytes.fromhex(grant.hop_id),
        grant.agent,
        grant.role,
        grant.key,
        grant.delegator,
        hop.delegator_thumbprint,
        grant.purpose,
        grant.request_digest,
        str(attestation.kind),
        attestation.measurement,
        attestation.at,
    )


def _restriction_rows(index: int, stated: Restriction) -> Iterator[Row]:
    for dimension in ("ceiling", "depth", "not_before", "not_after"):
        value = getattr(stated, dimension)
        if value is not None:
            yield "bound", (index, dimension, int(value))
    for dimension in ("audiences", "delegates"):
        members = getattr(stated, dimension)
        if members is not None:
            yield "bound", (index, dimension, len(members))
            yield from (("member", (index, dimension, k, member)) for k, member in enumerate(sorted(members)))
    if stated.grants is not None:
        yield "bound", (index, "grants", len(stated.grants))
        for g, grant in enumerate(stated.grants):
            yield "grant", (index, g, grant.object, grant.operation, len(grant.limits))
            for p, limit in enumerate(grant.limits):
                yield from _limit_rows((index, g, p, limit.parameter.name, str(limit.parameter.unit)), limit.bound)


def _limit_rows(head: tuple[Term, ...], bound: Bound) -> Iterator[Row]:
    match bound:
        case Range(low, high):
            yield "limit", (*head, low, high)
        case OneOf(values):
            yield from (("choice", (*head, k, value)) for k, value in enumerate(sorted(values)))


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


def authority_from_rows(found: Iterable[Row], caps: Caps) -> AuthorityBlock:
    """The authority block of these facts.

    Raises:
        TokenError: `WRONG_PROFILE` when the profile is another, `CHAIN_BROKEN` when the facts are not exactly those of
            one such block.
    """
    table = _table(found)
    if [terms[0] for terms in table["token"]] != [PROFILE]:
        raise TokenError(FaultCode.WRONG_PROFILE, f"not {PROFILE}")
    try:
        ((_, token_id),) = table["token"]
        ((issuer, subject, method, authenticated_at),) = table["sponsor"]
        stated = _restriction(table)
        block = AuthorityBlock(
            token_id=keys.b64u(_exact(token_id, _ID_BYTES)),
            sponsor=Sponsor(_text(issuer), _text(subject), _text(method), _int(authenticated_at)),
            hop=_hop(table),
            scope=Scope(
                grants=_present(stated.grants),
                ceiling=_present(stated.ceiling),
                audiences=_present(stated.audiences),
                delegates=_present(stated.delegates),
                depth=_present(stated.depth),
                not_before=_present(stated.not_before),
                not_after=_present(stated.not_after),
            ),
        )
        well_formed(block, caps)
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not an authority block: {error}") from None
    return _exactly(block, found)


def hop_from_rows(found: Iterable[Row], caps: Caps) -> HopBlock:
    """The hop block of these facts.

    Raises:
        TokenError: `CHAIN_BROKEN` when the facts are not exactly those of one such block.
    """
    table = _table(found)
    try:
        block = HopBlock(hop=_hop(table), restriction=_restriction(table))
        well_formed(block, caps)
    except (ValueError, CapabilityError) as error:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"not a hop block: {error}") from None
    return _exactly(block, found)


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
    _well_formed_hop(block.hop, caps)


def _well_formed_hop(hop: HopFacts, caps: Caps) -> None:
    grant = hop.grant
    if len(bytes.fromhex(grant.hop_id)) != _ID_BYTES or grant.hop_id != grant.hop_id.lower():
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a hop id is 32 hex digits")
    text.agent_id(grant.agent, most_bytes=caps.text_bytes)
    text.name(grant.delegator, most_bytes=caps.text_bytes)
    if grant.role:
        text.name(grant.role, most_bytes=caps.text_bytes - len(text.ROLE_PREFIX))
    text.prose(grant.purpose, most_bytes=caps.purpose_bytes)
    keys.check_raw(grant.key)
    _exact(grant.request_digest, _DIGEST_BYTES)
    _exact(grant.attestation.measurement, _DIGEST_BYTES)
    _seconds(grant.attestation.at)


def _table(found: Iterable[Row]) -> dict[str, list[tuple[Term, ...]]]:
    table: dict[str, list[tuple[Term, ...]]] = {predicate: [] for predicate in ARITY}
    for predicate, terms in found:
        table[predicate].append(terms)
    return table


def _hop(table: dict[str, list[tuple[Term, ...]]]) -> HopFacts:
    ((index, hop_id, agent, role, key, delegator, thumbprint, purpose, digest, kind, measurement, at),) = table["hop"]
    return HopFacts(
        index=_int(index),
        grant=HopGrant(
            hop_id=_exact(hop_id, _ID_BYTES).hex(),
            agent=_text(agent),
            key=_exact(key, keys.KEY_BYTES),
            delegator=_text(delegator),
            purpose=_text(purpose),
            request_digest=_exact(digest, _DIGEST_BYTES),
            attestation=Attestation(EvidenceKind(_text(kind)), _exact(measurement, _DIGEST_BYTES), _int(at)),
            role=_text(role),
        ),
        delegator_thumbprint=_bytes(thumbprint),
    )


def _restriction(table: dict[str, list[tuple[Term, ...]]]) -> Restriction:
    bounds = {_text(dimension): _int(value) for _, dimension, value in table["bound"]}
    members: dict[str, list[str]] = {"audiences": [], "delegates": []}
    for _, dimension, _, member in table["member"]:
        members.setdefault(_text(dimension), []).append(_text(member))
    return Restriction(
        grants=_grants(table) if "grants" in bounds else None,
        ceiling=Tier(bounds["ceiling"]) if "ceiling" in bounds else None,
        audiences=frozenset(members["audiences"]) if "audiences" in bounds else None,
        delegates=frozenset(members["delegates"]) if "delegates" in bounds else None,
        depth=bounds.get("depth"),
        not_before=bounds.get("not_before"),
        not_after=bounds.get("not_after"),
    )


def _grants(table: dict[str, list[tuple[Term, ...]]]) -> tuple[Grant, ...]:
    limits: dict[tuple[int, int], Limit] = {}
    chosen: dict[tuple[int, int, Parameter], set[int]] = {}
    for _, g, p, name, unit, low, high in table["limit"]:
        limits[_int(g), _int(p)] = Limit(Parameter(_text(name), Unit(_text(unit))), Range(_int(low), _int(high)))
    for _, g, p, name, unit, _, value in table["choice"]:
        chosen.setdefault((_int(g), _int(p), Parameter(_text(name), Unit(_text(unit)))), set()).add(_int(value))
    for (g, p, parameter), values in chosen.items():
        limits[g, p] = Limit(parameter, OneOf(frozenset(values)))
    in_order = sorted((_int(g), _text(thing), _text(operation)) for _, g, thing, operation, _ in table["grant"])
    return tuple(
        Grant(thing, operation, tuple(limits[at] for at in sorted(limits) if at[0] == g))
        for g, thing, operation in in_order
    )


_B = TypeVar("_B", AuthorityBlock, HopBlock)
_T = TypeVar("_T")


def _exactly(block: _B, found: Iterable[Row]) -> _B:
    """The block, when writing it again gives the same facts, each once: this checks ordinals, counts and order."""
    if Counter(rows(block)) != Counter(found):
        raise TokenError(FaultCode.CHAIN_BROKEN, "facts that no block of the profile has")
    return block


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


def _bytes(value: object) -> bytes:
    if not isinstance(value, bytes):
        raise ValueError("not bytes")  # noqa: TRY004 - as above
    return value


def _exact(value: object, length: int) -> bytes:
    raw = _bytes(value)
    if len(raw) != length:
        raise ValueError(f"not {length} bytes")
    return raw


def _seconds(value: object) -> None:
    if not 0 <= _int(value) < algebra.TIME_LIMIT:
        raise TokenError(FaultCode.OUT_OF_RANGE, "a time outside the calendar")

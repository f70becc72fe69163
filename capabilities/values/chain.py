"""A verified chain of authority, as values. An instance exists because `verify` made it: its existence is the proof."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, assert_never

from capabilities.values.errors import FaultCode  # noqa: TC001 - a dataclass field: its annotation must resolve
from capabilities.values.fast_dataclass import maker
from capabilities.values.scope import Bound, Scope  # noqa: TC001 - a dataclass field: its annotation must resolve
from capabilities.values.units import Kind  # noqa: TC001 - a dataclass field: its annotation must resolve


class EvidenceKind(StrEnum):
    """Kind of evidence that attested a delegate.

    It bounds lifetime and ceiling (capabilities.values.caps).
    """

    KEY = "key"
    """The agent's own key signed its own measurement. Proves the key, not the software."""
    JWT = "jwt"
    """Besides, a platform that the identity provider trusts signed its measurement of the software with this key."""
    CLIENT = "client"
    """An OAuth client was authorised by a person or mandate. Proves no key of its hop and no software."""
    BEARER = "bearer"
    """Besides, such a platform gave this workload a token, once: it names neither key nor software."""
    X509 = "x509"
    """Besides, the key of such a platform's certificate for this workload signed for the agent's key, just now."""
    RELEASE = "release"
    """Besides, a publisher that the identity provider trusts signed what the software is made of; not that it runs."""

    @property
    def vouched(self) -> bool:
        """True where a platform stood by the agent at that moment, which a thief of its key alone cannot show."""
        match self:
            case EvidenceKind.KEY | EvidenceKind.RELEASE | EvidenceKind.CLIENT:
                return False
            case EvidenceKind.JWT | EvidenceKind.BEARER | EvidenceKind.X509:
                return True
            case _:
                assert_never(self)


@dataclass(frozen=True, slots=True)
class Sponsor:
    """A human principal.

    Attributes:
        issuer: who authenticated the person (an issuer URL).
        subject: the person's id there.
        method: how, e.g. "operator-key".
        authenticated_at: when, seconds since the epoch.
    """

    issuer: str
    subject: str
    method: str
    authenticated_at: int


@dataclass(frozen=True, slots=True)
class Attestation:
    """The identity provider's statement about a hop's agent, as its block carries it.

    Attributes:
        kind: form of the evidence.
        measurement: SHA-256 over the agent's software, as the agent stated it (and, with kind `jwt`, the platform).
        at: seconds since the epoch.
    """

    kind: EvidenceKind
    measurement: bytes
    at: int


@dataclass(frozen=True, slots=True)
class HopGrant:
    """Statement of the identity provider about a new holder, as its block carries it.

    Fields as in `Hop`.
    """

    hop_id: str
    agent: str
    key: bytes
    delegator: str
    purpose: str
    request_digest: bytes
    attestation: Attestation
    role: str = ""


@dataclass(frozen=True, slots=True)
class Hop:
    """One holder in the chain.

    Attributes:
        index: 0 is the authority block's agent.
        hop_id: 16 random bytes as 32 hex digits; the unit of revocation.
        agent: the holder's id.
        key: the holder's Ed25519 public key, 32 raw bytes.
        delegator: agent id of the parent hop; the sponsor's subject at hop 0.
        purpose: stated reason of the delegation.
        request_digest: SHA-256 of the delegator's signed request, kept in the ledger.
        attestation: see there.
        scope: the scope from here on (the meet so far).
        role: the holder's role among the sponsor's own agents, as the attester vouches for it; empty for none, and for
            an agent of another sponsor, which can therefore be delegated to by name alone.
    """

    index: int
    hop_id: str
    agent: str
    key: bytes
    delegator: str
    purpose: str
    request_digest: bytes
    attestation: Attestation
    scope: Scope
    role: str = ""


@dataclass(frozen=True, slots=True)
class Chain:
    """A chain that passed steps 1 to 9 of `verify`.

    Attributes:
        token_id: of the authority block; 22 base64url characters.
        digest: SHA-256 of the canonical bytes.
        sponsor: the human root.
        root_key_id: which root key signed.
        hops: in order, at least one.
        epoch: of the revocation view that it was checked against.
        view_age_ms: age of that view, on the verifier's monotonic clock.
        mandate_id: of the mandate that the token was drawn from, 32 hex digits; None for one that its sponsor issued.
    """

    token_id: str
    digest: bytes
    sponsor: Sponsor
    root_key_id: int
    hops: tuple[Hop, ...]
    epoch: int
    view_age_ms: int
    mandate_id: str | None = None

    @property
    def leaf(self) -> Hop:
        """The holder."""
        return self.hops[-1]

    @property
    def scope(self) -> Scope:
        """The effective scope: the meet of all blocks."""
        return self.leaf.scope


make_sponsor: Final = maker(Sponsor)
make_attestation: Final = maker(Attestation)
make_grant: Final = maker(HopGrant)
make_hop: Final = maker(Hop)
make_chain: Final = maker(Chain)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Refusal of a request outside a chain or a robot's own limits, with the hop that set the bound.

    Attributes:
        code: `NOT_GRANTED`, `PARAMETERS_WRONG`, `LIMIT_EXCEEDED_BY_REQUEST`, `ABOVE_CEILING` or an engine's fault.
        parameter, value, unit, bound, nearest: of the parameter that is out of bounds: `value` is its integer, truth
            value, word or list, or a free value's size; `unit` its kind; `nearest` the permitted value nearest to it.
        hop: index of the hop that set the tightest bound, or None when no hop did (the robot's own limit).
        hop_id, agent, sponsor: that hop's id and holder, and the person behind the chain.
        detail: for the record.
    """

    code: FaultCode
    parameter: str | None = None
    value: int | bool | str | tuple[int | bool | str, ...] | None = None
    unit: Kind | None = None
    bound: Bound | None = None
    nearest: int | bool | str | tuple[int | bool | str, ...] | None = None
    hop: int | None = None
    hop_id: str | None = None
    agent: str | None = None
    sponsor: str | None = None
    detail: str = ""

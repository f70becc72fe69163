"""Commands of OAuth. Everything was parsed strictly at the edge; ids and digests of secrets are fresh randomness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.domain.signed import SignedRequest


@dataclass(frozen=True, slots=True)
class RegisterClient:
    """An administrator registers a client, and the agent that stands for it.

    Attributes:
        sponsor: the person who answers for the agent.
        key: raw public key of `private_key_jwt`, or None for a public client.
        agent_key: raw public key of the agent, whose private half nobody has.
    """

    by: str
    client_id: str
    name: str
    sponsor: str
    redirects: tuple[str, ...]
    key: bytes | None
    agent_key: bytes
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class DeclareTemplate:
    """A person declares the meaning of an OAuth scope; `limits` is canonical JSON of grants and ceiling."""

    by: str
    name: str
    words: str
    audience: str
    limits: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class EndTemplate:
    """A person ends a scope template: nobody is lent by it from now on."""

    by: str
    name: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class Assent:
    """A person lets a client act; the code is the client's way to the tokens.

    Attributes:
        client_id: a registered client's, or the URL of a client's metadata document.
        agent: id of the agent that stands for it; `agent_key` and `document` are used where it is not registered yet.
        client_name: host or name of the client.
        document: SHA-256 of the metadata document; of a registered client 32 zero bytes.
        templates: names of the scopes that the person chose.
        resource: the one audience.
        redirect, challenge, jkt: as in `CodeRecord` and `FamilyRecord`.
        method, authenticated_at: how and when the person logged in (seconds since the epoch).
        family: 32 hex digits; code: SHA-256 of the code in hex.
    """

    by: str
    client_id: str
    agent: str
    agent_key: bytes
    client_name: str
    document: bytes
    templates: frozenset[str]
    resource: str
    redirect: str
    challenge: str
    jkt: str | None
    method: str
    authenticated_at: int
    family: str
    code: str


@dataclass(frozen=True, slots=True)
class Minting:
    """Parts that every command has by which an access token is made.

    Attributes:
        jkt: thumbprint of the DPoP key that the request proved, or None.
        request_digest: SHA-256 of the canonical request.
        evidence: the client's signed assertion or DPoP proof, or "".
        token_id, hop_id: fresh.
        signed: the request, without its secrets.
    """

    jkt: str | None
    request_digest: bytes
    evidence: str
    token_id: str
    hop_id: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class RedeemCode:
    """A client's agent redeems a code; `code` and `refresh` are digests, `challenge` is of the verifier it sent."""

    by: str
    sponsor: str
    client_id: str
    code: str
    redirect: str
    challenge: str
    resource: str | None
    refresh: str
    minting: Minting


@dataclass(frozen=True, slots=True)
class Refresh:
    """A client's agent uses a refresh token.

    `used` and `refresh` are the digests of the old one and of the new one.
    """

    by: str
    sponsor: str
    client_id: str
    used: str
    scope: str | None
    resource: str | None
    refresh: str
    minting: Minting


@dataclass(frozen=True, slots=True)
class DrawAccess:
    """A client's agent draws an access token from a mandate, by `client_credentials`."""

    by: str
    client_id: str
    mandate_id: str
    resource: str
    scope: tuple[str, ...]
    minting: Minting


@dataclass(frozen=True, slots=True)
class EndAccess:
    """A client's agent gives back an access token (`jti`), or a refresh token (its digest), with its family."""

    by: str
    client_id: str
    jti: str | None
    refresh: str | None


@dataclass(frozen=True, slots=True)
class EndFamily:
    """A person takes back what it lent to a client."""

    by: str
    family: str
    reason: str


OAuthCommand = (
    RegisterClient | DeclareTemplate | EndTemplate | Assent | RedeemCode | Refresh | DrawAccess | EndAccess | EndFamily
)

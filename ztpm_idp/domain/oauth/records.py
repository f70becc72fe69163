"""Records of OAuth: clients, scope templates, families of tokens, codes, refresh tokens, access tokens.

Secrets are kept as their SHA-256 in hex. The capability behind an access token is kept whole: it stays on our side, and
nobody has the key of a client's hop.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClientRecord:
    """A client that an administrator registered.

    Attributes:
        client_id: also the id of its agent, which stands in tokens and records.
        name: as shown to people.
        key: raw public key of `private_key_jwt`, or None for a public client.
        redirects: exact redirect URIs; of a loopback one any port will do.
    """

    client_id: str
    name: str
    key: bytes | None
    redirects: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class TemplateRecord:
    """Scope template: the meaning of one OAuth scope.

    Attributes:
        name: of the OAuth scope, such as "camera.read".
        words: what it allows, for people.
        audience: the one tool server that it is for.
        limits: grants and ceiling, canonical JSON of a restriction.
        by: the person who declared it.
    """

    name: str
    words: str
    audience: str
    limits: str
    by: str


@dataclass(frozen=True, slots=True)
class FamilyRecord:
    """All tokens that one assent of a person led to.

    Attributes:
        family: 32 hex digits.
        client_id: id or URL of the client.
        agent: id of the agent that stands for it.
        sponsor, method, authenticated_at: who assented, and how and when that person logged in (seconds).
        resource: the one audience.
        scope: names of templates, in order, separated by spaces.
        limits: grants and ceiling as they were at the assent, canonical JSON of a restriction.
        jkt: thumbprint of the DPoP key that all tokens are bound to, or None for bearer tokens.
        not_after: its end, seconds since the epoch.
        ended: nothing more comes of it.
    """

    family: str
    client_id: str
    agent: str
    sponsor: str
    method: str
    authenticated_at: int
    resource: str
    scope: str
    limits: str
    jkt: str | None
    not_after: int
    ended: bool = False


@dataclass(frozen=True, slots=True)
class CodeRecord:
    """An authorization code; `challenge` is that of PKCE, S256."""

    digest: str
    family: FamilyRecord
    redirect: str
    challenge: str
    given_ms: int
    spent: bool = False


@dataclass(frozen=True, slots=True)
class RefreshRecord:
    """A refresh token, good once."""

    digest: str
    family: FamilyRecord
    spent: bool = False


@dataclass(frozen=True, slots=True)
class AccessRecord:
    """An access token and the capability behind it.

    Attributes:
        jti: of the token, and id of the capability's last hop.
        token_id: of the capability.
        family: that it came of, or None for one of a mandate or an exchange.
        client_id: the client, or the delegate of an exchange.
        actors: agents of the chain, the holder first.
        sponsor: the person behind it.
        authenticated_at: when that person was authenticated, seconds since the epoch.
        audience: its one resource server.
        scope: names of templates; empty where none was asked for.
        jkt: thumbprint of the key that it is bound to, or None.
        issued_at, not_after: seconds since the epoch.
        capability: text of the capability token.
    """

    jti: str
    token_id: str
    family: str | None
    client_id: str
    actors: tuple[str, ...]
    sponsor: str
    authenticated_at: int
    audience: str
    scope: str
    jkt: str | None
    issued_at: int
    not_after: int
    capability: str = ""

    def __repr__(self) -> str:
        return f"AccessRecord(jti={self.jti!r}, client_id={self.client_id!r}, sponsor={self.sponsor!r})"


@dataclass(frozen=True, slots=True)
class OAuthWanted:
    """OAuth records that a command needs."""

    client: str | None = None
    templates: frozenset[str] = frozenset()
    code: str | None = None
    """Digest of a code; its family's live access tokens come with it."""
    refresh: str | None = None
    """Digest of a refresh token; its family's live access tokens come with it."""
    family: str | None = None
    """A family, with its live access tokens."""
    access: str | None = None
    """The `jti` of an access token."""


@dataclass(frozen=True, slots=True)
class OAuthState:
    """OAuth records that were loaded.

    `access` and the `live` ones of the loaded family are access tokens that may be live: none that is revoked.
    """

    client: ClientRecord | None = None
    templates: tuple[TemplateRecord, ...] = ()
    code: CodeRecord | None = None
    refresh: RefreshRecord | None = None
    family: FamilyRecord | None = None
    access: AccessRecord | None = None
    live: tuple[AccessRecord, ...] = ()


NOTHING: OAuthState = OAuthState()

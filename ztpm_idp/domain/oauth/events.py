"""Events of OAuth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.domain.oauth.records import AccessRecord, ClientRecord, CodeRecord, TemplateRecord
    from ztpm_idp.domain.signed import SignedRequest


@dataclass(frozen=True, slots=True)
class ClientRegistered:
    """A client exists from now on, and its agent with it."""

    client: ClientRecord
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class TemplateDeclared:
    """An OAuth scope means this from now on."""

    template: TemplateRecord
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class TemplateEnded:
    """An OAuth scope means nothing from now on."""

    name: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class AssentGiven:
    """A person let a client act; its code waits for the client."""

    code: CodeRecord


@dataclass(frozen=True, slots=True)
class CodeSpent:
    """A code is spent, for ever; its family is bound to this key, if any.

    Not in the ledger: the token is.
    """

    digest: str
    family: str
    jkt: str | None


@dataclass(frozen=True, slots=True)
class RefreshSpent:
    """A refresh token is spent, for ever. Not in the ledger: the token that it led to is."""

    digest: str


@dataclass(frozen=True, slots=True)
class RefreshMade:
    """A refresh token waits for its one use. Not in the ledger: the access token beside it is."""

    digest: str
    family: str


@dataclass(frozen=True, slots=True)
class AccessMade:
    """A client has an access token from now on."""

    access: AccessRecord


@dataclass(frozen=True, slots=True)
class FamilyEnded:
    """Nothing more comes of an assent."""

    family: str
    client_id: str
    sponsor: str
    reason: str


OAuthEvent = (
    ClientRegistered
    | TemplateDeclared
    | TemplateEnded
    | AssentGiven
    | CodeSpent
    | RefreshSpent
    | RefreshMade
    | AccessMade
    | FamilyEnded
)

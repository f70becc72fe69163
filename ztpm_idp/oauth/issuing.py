"""The grants of the token endpoint: each becomes one command, and its events one answer."""

from __future__ import annotations

import base64
import hashlib
import re
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import b64u
from capabilities.statements.people import mandate as mandate_statement
from capabilities.values import text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import ScopeError
from capabilities.values.strict_json import canonical
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import SignedRequest
from ztpm_idp.domain.oauth.commands import DrawAccess, Minting, RedeemCode, Refresh
from ztpm_idp.domain.oauth.events import AccessMade
from ztpm_idp.oauth.access_token import sign
from ztpm_idp.oauth.form import needed
from ztpm_idp.oauth.problem import OAuthError, OAuthProblem, of_refusal
from ztpm_idp.provider.problems import Problem

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.domain.commands import Command
    from ztpm_idp.domain.oauth.records import AccessRecord
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.oauth.client_auth import Client
    from ztpm_idp.provider.provider import Provider

CODE: Final = "authorization_code"
REFRESH: Final = "refresh_token"
CREDENTIALS: Final = "client_credentials"
EXCHANGE: Final = "urn:ietf:params:oauth:grant-type:token-exchange"
SECRETS: Final = frozenset(
    {"code", "code_verifier", "refresh_token", "client_assertion", "subject_token", "actor_token", "token"}
)
"""Parameters that the ledger has by their SHA-256 alone."""
SECRET_BYTES: Final = 32
_VERIFIER: Final = re.compile(r"[A-Za-z0-9._~-]{43,128}", re.ASCII)
"""RFC 7636 section 4.1."""
_SECRET: Final = re.compile(r"[A-Za-z0-9_-]{43}", re.ASCII)
SCOPE_NAME: Final = re.compile(r"[a-z][a-z0-9._:-]{0,63}", re.ASCII)
"""Name of a scope template."""


@dataclass(frozen=True, slots=True)
class TokenRequest:
    """An authenticated request to the token endpoint.

    Attributes:
        form: its parameters.
        client: who sent it.
        jkt: thumbprint of the DPoP key that it proved, or None.
        proof: the DPoP proof, or "".
        url: of the endpoint.
    """

    form: Mapping[str, str]
    client: Client
    jkt: str | None
    proof: str
    url: str

    def minting(self) -> Minting:
        """Fresh ids, and the request as the ledger keeps it."""
        kept = without_secrets(self.form)
        body = canonical(kept)
        return Minting(
            jkt=self.jkt,
            request_digest=hashlib.sha256(body).digest(),
            evidence=self.client.assertion or self.proof,
            token_id=b64u(secrets.token_bytes(16)),
            hop_id=secrets.token_hex(16),
            signed=SignedRequest("POST", self.url, body.decode(), self.proof or self.client.assertion),
        )


async def by_code(provider: Provider, keys: OAuthKeys, request: TokenRequest) -> dict[str, object]:
    """First tokens for an authorization code."""
    form, secret = request.form, needed(request.form, "code")
    verifier = needed(form, "code_verifier")
    if not _VERIFIER.fullmatch(verifier):
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "code_verifier has 43 to 128 characters (RFC 7636)")
    redirect, digest = needed(form, "redirect_uri"), digest_of(secret)
    async with provider.store.read() as view:
        code = await view.oauth.code(digest)
    if code is None:
        raise of_refusal(IdpCode.CODE_REFUSED, "no such code of this client")
    fresh = secrets.token_urlsafe(SECRET_BYTES)
    command = RedeemCode(
        by=code.family.agent,
        sponsor=code.family.sponsor,
        client_id=request.client.client_id,
        code=digest,
        redirect=redirect,
        challenge=challenge_of(verifier),
        resource=form.get("resource"),
        refresh=digest_of(fresh),
        minting=request.minting(),
    )
    access = await _done(provider, command, IdpCode.CODE_REFUSED)
    return answer_of(access, keys, issuer=provider.settings.issuer, refresh=fresh)


async def by_refresh(provider: Provider, keys: OAuthKeys, request: TokenRequest) -> dict[str, object]:
    """The next tokens for a refresh token, which is spent by that."""
    digest = digest_of(needed(request.form, "refresh_token"))
    async with provider.store.read() as view:
        known = await view.oauth.refresh(digest)
    if known is None:
        raise of_refusal(IdpCode.REFRESH_REFUSED, "no such refresh token of this client")
    fresh, asked = secrets.token_urlsafe(SECRET_BYTES), scopes_of(request.form)
    command = Refresh(
        by=known.family.agent,
        sponsor=known.family.sponsor,
        client_id=request.client.client_id,
        used=digest,
        scope=" ".join(sorted(asked)) if asked else None,
        resource=request.form.get("resource"),
        refresh=digest_of(fresh),
        minting=request.minting(),
    )
    access = await _done(provider, command, IdpCode.REFRESH_REFUSED)
    return answer_of(access, keys, issuer=provider.settings.issuer, refresh=fresh)


async def by_credentials(provider: Provider, keys: OAuthKeys, request: TokenRequest) -> dict[str, object]:
    """An access token from a mandate that names the client: the newest one in force for this resource."""
    record = request.client.record
    if record is None or record.key is None:
        raise OAuthProblem(OAuthError.UNAUTHORIZED_CLIENT, "client_credentials needs private_key_jwt and a mandate")
    resource = resource_of(request.form)
    async with provider.store.read() as view:
        found = await view.lending.mandates(
            since_s=provider.now_ms() // 1_000 + 1, agents={record.client_id}, key=None, sponsor=None
        )
    fitting = [
        mandate.mandate_id
        for mandate in found
        if mandate.agent == record.client_id and resource in mandate_statement.read_again(mandate.text).scope.audiences
    ]
    if not fitting:
        raise OAuthProblem(
            OAuthError.UNAUTHORIZED_CLIENT, "MANDATE_UNKNOWN: no mandate in force names this client for this resource"
        )
    command = DrawAccess(
        by=record.client_id,
        client_id=record.client_id,
        mandate_id=fitting[0],
        resource=resource,
        scope=scopes_of(request.form),
        minting=request.minting(),
    )
    access = await _done(provider, command, IdpCode.MANDATE_UNKNOWN)
    return answer_of(access, keys, issuer=provider.settings.issuer)


def answer_of(access: AccessRecord, keys: OAuthKeys, *, issuer: str, refresh: str | None = None) -> dict[str, object]:
    """The body of a token response (RFC 6749 section 5.1)."""
    body: dict[str, object] = {
        "access_token": sign(access, keys, issuer=issuer),
        "token_type": "Bearer" if access.jkt is None else "DPoP",
        "expires_in": access.not_after - access.issued_at,
    }
    if access.scope:
        body["scope"] = access.scope
    if refresh is not None:
        body["refresh_token"] = refresh
    return body


async def _done(provider: Provider, command: Command, nothing: IdpCode) -> AccessRecord:
    """The access token that the command made; `nothing` is the code where it ended a family instead."""
    try:
        done = await provider.run(command, actor=command.by)  # type: ignore[union-attr]
    except Problem as problem:
        raise of_refusal(problem.code, problem.detail) from None
    for event in done.events:
        if isinstance(event, AccessMade):
            return event.access
    raise of_refusal(nothing, "it was used before: all that came of it is over")


def scopes_of(form: Mapping[str, str]) -> tuple[str, ...]:
    """Names of scopes, each once, in order.

    Raises:
        OAuthProblem: `invalid_scope`.
    """
    names = sorted(set(form.get("scope", "").split(" ")) - {""})
    if not all(map(SCOPE_NAME.fullmatch, names)):
        raise OAuthProblem(OAuthError.INVALID_SCOPE, "no such scope")
    return tuple(names)


def resource_of(form: Mapping[str, str]) -> str:
    """The one resource that the token is for.

    Raises:
        OAuthProblem: `invalid_target`.
    """
    resource = form.get("resource")
    if resource is None:
        raise OAuthProblem(OAuthError.INVALID_TARGET, "resource is missing: a token serves one audience (RFC 8707)")
    try:
        text.url(resource, most_bytes=DEFAULT.text_bytes)
    except ScopeError:
        raise OAuthProblem(OAuthError.INVALID_TARGET, "resource is not a canonical URL") from None
    return resource


def challenge_of(verifier: str) -> str:
    """The S256 challenge of a PKCE verifier (RFC 7636 section 4.2)."""
    return base64.urlsafe_b64encode(hashlib.sha256(verifier.encode()).digest()).rstrip(b"=").decode()


def digest_of(secret: str) -> str:
    """SHA-256 (hex) of a code or refresh token of ours; of any other text a digest that nothing has."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest() if _SECRET.fullmatch(secret) else ""


def without_secrets(form: Mapping[str, str]) -> dict[str, str]:
    """The parameters as the ledger keeps them."""
    return {
        name: hashlib.sha256(value.encode("utf-8", "surrogatepass")).hexdigest() if name in SECRETS else value
        for name, value in form.items()
    }

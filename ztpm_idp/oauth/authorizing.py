"""Authorization requests (RFC 6749 section 4.1, OAuth 2.1): read strictly, answered to a known redirect URI alone."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode

from ztpm_idp.oauth.issuing import resource_of, scopes_of
from ztpm_idp.oauth.problem import OAuthError, OAuthProblem
from ztpm_idp.oauth.redirect import answered, is_one_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ztpm_idp.domain.oauth.records import TemplateRecord

STATE_BYTES: Final = 512
_CHALLENGE: Final = re.compile(r"[A-Za-z0-9_-]{43}", re.ASCII)
"""An S256 challenge, and a thumbprint: SHA-256 in base64url."""


class NoRedirectError(Exception):
    """A request whose redirect URI is not its client's: the person is told, and nobody else.

    Attributes:
        why: a fixed sentence.
    """

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.why = why


@dataclass(frozen=True, slots=True)
class Asking:
    """Client that asks for an authorization, as far as it is known.

    Attributes:
        client_id: id, or URL of its document.
        agent: id of the agent that stands for it, for this person.
        name: as an administrator registered it, or as the client calls itself.
        host: of a document's URL; "" for a registered client.
        redirects: exact URIs.
        document: SHA-256 of its document; 32 zero bytes for a registered client.
    """

    client_id: str
    agent: str
    name: str
    host: str
    redirects: tuple[str, ...]
    document: bytes = bytes(32)


@dataclass(frozen=True, slots=True)
class AuthorizationRequest:
    """A whole request, whose redirect URI is the client's.

    Attributes:
        redirect: exact URI.
        state: of the client, or None.
        challenge: of PKCE, S256.
        jkt: thumbprint of the DPoP key that the code is for, or None.
        resource: the one audience, or None where the scope says it.
        scope: names of scopes; empty: every scope of the resource.
    """

    redirect: str
    state: str | None
    challenge: str
    jkt: str | None
    resource: str | None
    scope: tuple[str, ...]


def redirect_of(parameters: Mapping[str, str], asking: Asking) -> str:
    """The redirect URI of a request, which must be the client's.

    Raises:
        NoRedirectError: it is missing or another's. Nothing is sent there.
    """
    redirect = parameters.get("redirect_uri")
    if redirect is None or not is_one_of(redirect, asking.redirects):
        raise NoRedirectError("redirect_uri is none of those that the client registered, character by character")
    return redirect


def read_request(parameters: Mapping[str, str], redirect: str) -> AuthorizationRequest:
    """The request, when it is whole.

    Raises:
        OAuthProblem: to be told to the client at its redirect URI.
    """
    if parameters.get("response_type") != "code":
        raise OAuthProblem(OAuthError.UNSUPPORTED_RESPONSE_TYPE, "response_type is code")
    if parameters.get("response_mode", "query") != "query":
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "response_mode is query")
    if "request" in parameters or "request_uri" in parameters:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "request objects are not taken")
    challenge, jkt = parameters.get("code_challenge", ""), parameters.get("dpop_jkt")
    if parameters.get("code_challenge_method") != "S256" or not _CHALLENGE.fullmatch(challenge):
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "code_challenge with code_challenge_method S256 is needed")
    if jkt is not None and not _CHALLENGE.fullmatch(jkt):
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "dpop_jkt is the thumbprint of a key")
    state = parameters.get("state")
    if state is not None and len(state) > STATE_BYTES:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"state has at most {STATE_BYTES} characters")
    resource = None if "resource" not in parameters else resource_of(parameters)
    return AuthorizationRequest(redirect, state, challenge, jkt, resource, scopes_of(parameters))


def chosen_of(asked: AuthorizationRequest, known: Sequence[TemplateRecord]) -> tuple[TemplateRecord, ...]:
    """The templates that the person is asked about: those of one resource, which the request names.

    A scope of another resource is left out, as a client may name every scope that the metadata lists.

    Raises:
        OAuthProblem: `invalid_scope` for a scope that nobody declared, or none that is left; `invalid_target` where
            several resources would be meant.
    """
    if set(asked.scope) - {template.name for template in known}:
        raise OAuthProblem(OAuthError.INVALID_SCOPE, "SCOPE_UNKNOWN: the metadata lists the scopes")
    named = [template for template in known if not asked.scope or template.name in asked.scope]
    if asked.resource is not None:
        named = [template for template in named if template.audience == asked.resource]
    if not named:
        raise OAuthProblem(OAuthError.INVALID_SCOPE, "SCOPE_UNKNOWN: no scope of this resource was declared")
    if len({template.audience for template in named}) > 1:
        raise OAuthProblem(OAuthError.INVALID_TARGET, "resource is missing, and the scopes are of several")
    return tuple(named)


def response_to(redirect: str, *, issuer: str, state: str | None, **told: str) -> str:
    """The address to which a browser is sent with the answer; it names the issuer (RFC 9207)."""
    return answered(redirect, told | ({} if state is None else {"state": state}) | {"iss": issuer})


def query_text(parameters: Mapping[str, str]) -> str:
    """The parameters in one spelling, as a page of ours goes back to."""
    return urlencode(sorted(parameters.items()))

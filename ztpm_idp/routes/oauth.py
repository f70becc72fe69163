"""The endpoints of clients: metadata, keys, tokens, introspection, revocation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final

from fastapi import APIRouter, Depends, Request
from fastapi.responses import JSONResponse, Response

from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.oauth.commands import EndAccess
from ztpm_idp.oauth import dpop, metadata
from ztpm_idp.oauth.access_token import jti_of
from ztpm_idp.oauth.client_auth import client_of
from ztpm_idp.oauth.exchanging import exchange
from ztpm_idp.oauth.form import form_of, needed
from ztpm_idp.oauth.issuing import (
    CODE,
    CREDENTIALS,
    EXCHANGE,
    REFRESH,
    TokenRequest,
    by_code,
    by_credentials,
    by_refresh,
    digest_of,
)
from ztpm_idp.oauth.problem import NO_STORE, OAuthError, OAuthProblem, of_refusal
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    SCOPE_BYTES,
    Call,
    authenticated,
    authenticated_with,
    prefix_of,
    provider_of,
    query_of,
    read_body,
)
from ztpm_idp.routes.described import OAUTH, form_body
from ztpm_idp.routes.tokens import digest_of_request, named

if TYPE_CHECKING:
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.oauth.looking import Lookups

router = APIRouter()
well_known = APIRouter()
"""Routes at the root of the origin, where path-aware clients look: the issuer's path stands behind."""
Caller = Annotated[Call, Depends(authenticated)]
ANY_ORIGIN: Final = {"Access-Control-Allow-Origin": "*"}
"""Pages of clients in browsers may read: there is no cookie behind these endpoints, and nothing secret in the first."""
TOLD: Final = ANY_ORIGIN | {"Cache-Control": "public, max-age=300"}
CROSS: Final = ANY_ORIGIN | {"Access-Control-Expose-Headers": "DPoP-Nonce, WWW-Authenticate"}
PREFLIGHT: Final = ANY_ORIGIN | {
    "Access-Control-Allow-Methods": "POST",
    "Access-Control-Allow-Headers": "Content-Type, DPoP",
    "Access-Control-Max-Age": "600",
}
OF_CLIENTS: Final = frozenset({metadata.TOKEN, metadata.INTROSPECT, metadata.REVOKE})
"""Paths whose refusals have the form of OAuth, also where the store fails."""
_TOKEN_FORM: Final = form_body(
    "grant_type",
    optional=(
        "client_id",
        "client_assertion",
        "client_assertion_type",
        "code",
        "code_verifier",
        "redirect_uri",
        "refresh_token",
        "resource",
        "scope",
        "subject_token",
        "subject_token_type",
        "actor_token",
        "actor_token_type",
        "requested_token_type",
        "authorization_details",
    ),
)
_REVOKE_FORM: Final = form_body(
    "token", optional=("token_type_hint", "client_id", "client_assertion", "client_assertion_type")
)


def keys_of(request: Request) -> OAuthKeys:
    """The keys of the authorization server.

    Raises:
        Problem: `PATH_UNKNOWN` where there is none.
    """
    keys = provider_of(request).oauth
    if keys is None:
        raise Problem(IdpCode.PATH_UNKNOWN)
    return keys


def _of_issuer(request: Request) -> None:
    """Checks that the path behind a well-known one, where there is one, is the issuer's.

    Raises:
        Problem: `PATH_UNKNOWN`.
    """
    prefix = prefix_of(provider_of(request))
    if request.path_params.get("path", prefix) != prefix:
        raise Problem(IdpCode.PATH_UNKNOWN)


@router.get(metadata.AT_SERVER)
@router.get(metadata.AT_OPENID)
@well_known.get(metadata.AT_SERVER + "{path:path}")
@well_known.get(metadata.AT_OPENID + "{path:path}")
async def describe_server(request: Request) -> JSONResponse:
    """Description of the authorization server (RFC 8414)."""
    keys_of(request)
    provider = provider_of(request)
    _of_issuer(request)
    async with provider.store.read() as view:
        scopes = [template.name for template in await view.oauth.templates()]
    told = metadata.of_server(provider.settings.issuer, scopes=scopes, documents=provider.settings.client_documents)
    return JSONResponse(told, headers=TOLD)


@router.get(metadata.AT_RESOURCE)
@well_known.get(metadata.AT_RESOURCE + "{path:path}")
async def describe_resource(request: Request) -> JSONResponse:
    """Description of the provider's own resource (RFC 9728)."""
    keys_of(request)
    issuer = provider_of(request).settings.issuer
    _of_issuer(request)
    return JSONResponse(metadata.of_resource(issuer), headers=TOLD)


@router.get(metadata.JWKS)
async def jwks(request: Request) -> JSONResponse:
    """Keys that sign access tokens (RFC 7517)."""
    return JSONResponse(keys_of(request).jwks, headers=TOLD)


@router.options(metadata.TOKEN, status_code=204, include_in_schema=False)
@router.options(metadata.REVOKE, status_code=204, include_in_schema=False)
async def preflight(request: Request) -> Response:
    """Methods and headers that a page of a client may send from a browser."""
    keys_of(request)
    return Response(status_code=204, headers=PREFLIGHT)


@router.post(metadata.TOKEN, responses=OAUTH, openapi_extra=_TOKEN_FORM)
async def token(request: Request) -> JSONResponse:
    """An access token, by code, refresh token, mandate or exchange."""
    keys, provider = keys_of(request), provider_of(request)
    raw, url = await _body(request), provider.settings.issuer + metadata.TOKEN
    form = form_of(raw, request.headers.get("content-type", ""))
    kind = needed(form, "grant_type")
    if kind == EXCHANGE:
        return JSONResponse(await _exchange(request, keys, raw, form), headers=NO_STORE | CROSS)
    granting = {CODE: by_code, REFRESH: by_refresh, CREDENTIALS: by_credentials}.get(kind)
    if granting is None:
        raise OAuthProblem(OAuthError.UNSUPPORTED_GRANT_TYPE, "the metadata lists the grant types")
    proofs = request.headers.getlist("dpop")
    # The proof first: a client that has to send it again with a nonce sends its one assertion again, too.
    jkt = await dpop.thumbprint_of(provider, keys, proofs, url=url)
    client = await client_of(provider, form, authorization="authorization" in request.headers, endpoint=url)
    asked = TokenRequest(form, client, jkt, proofs[0] if proofs else "", url)
    headers = NO_STORE | CROSS
    if jkt is not None:
        headers |= {dpop.HEADER: dpop.nonce(keys, at_s=provider.now_ms() // 1_000)}
    return JSONResponse(await granting(provider, keys, asked), headers=headers)


@router.post(metadata.INTROSPECT, responses=OAUTH, openapi_extra=form_body("token", optional=("token_type_hint",)))
async def introspect(request: Request, call: Caller) -> JSONResponse:
    """An access token with its capability, told to an enforcement point of its audience (RFC 7662)."""
    keys = keys_of(request)
    form = form_of(call.raw, request.headers.get("content-type", ""))
    lookups: Lookups = request.app.state.lookups
    told = await lookups.look(keys, needed(form, "token"), asker=call.party)
    return JSONResponse(told, headers=NO_STORE)


@router.post(metadata.REVOKE, response_class=Response, responses=OAUTH, openapi_extra=_REVOKE_FORM)
async def revoke(request: Request) -> Response:
    """A client gives a token back (RFC 7009). The answer is the same for a token that is none."""
    keys, provider = keys_of(request), provider_of(request)
    form = form_of(await _body(request), request.headers.get("content-type", ""))
    url = provider.settings.issuer + metadata.REVOKE
    text = needed(form, "token")
    client = await client_of(provider, form, authorization="authorization" in request.headers, endpoint=url)
    jti, digest = jti_of(text, keys, issuer=provider.settings.issuer), digest_of(text) or None
    async with provider.store.read() as view:
        access = None if jti is None else await view.oauth.access(jti)
        refresh = None if digest is None else await view.oauth.refresh(digest)
    agent = access.actors[0] if access is not None else None if refresh is None else refresh.family.agent
    if agent is not None:
        try:
            await provider.run(EndAccess(agent, client.client_id, jti, digest), actor=agent)
        except Problem as problem:
            raise of_refusal(problem.code, problem.detail) from None
    return Response(status_code=200, headers=NO_STORE | CROSS)


async def _body(request: Request) -> bytes:
    try:
        query_of(request)
        return await read_body(request, body_bytes=SCOPE_BYTES)
    except Problem as problem:
        raise of_refusal(problem.code, problem.detail) from None


async def _exchange(request: Request, keys: OAuthKeys, raw: bytes, form: dict[str, str]) -> dict[str, Any]:
    try:
        call = await authenticated_with(request, raw)
    except Problem as problem:
        if problem.code is IdpCode.RATE_EXCEEDED:
            raise of_refusal(problem.code, problem.detail, again_s=problem.again_s) from None
        if problem.code in {IdpCode.CALLER_UNKNOWN, IdpCode.CALLER_INACTIVE}:
            raise OAuthProblem(OAuthError.INVALID_CLIENT, problem.code.value) from None
        raise OAuthProblem(OAuthError.INVALID_DPOP_PROOF, problem.code.value) from None
    return await exchange(
        provider_of(request),
        keys,
        form,
        holder=call.party.id,
        key=call.key,
        signed=call.sent,
        named=named,
        digest=digest_of_request,
    )

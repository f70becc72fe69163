"""Clients and scopes of OAuth as administrators and sponsors make them, and what people lent to clients."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from pydantic import AfterValidator, Field

from capabilities.keys.keys import generate, public_raw, unb64u
from capabilities.statements.claims import ID
from capabilities.values.strict_json import canonical, parse_object
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.oauth.commands import DeclareTemplate, EndFamily, EndTemplate, RegisterClient
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson
from ztpm_idp.oauth.issuing import SCOPE_NAME
from ztpm_idp.oauth.redirect import REDIRECT_BYTES, REDIRECTS, may_be_registered
from ztpm_idp.provider import wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    SCOPE_BYTES,
    Call,
    authenticated,
    authenticated_within,
    body_of,
    provider_of,
    query_of,
)
from ztpm_idp.routes.oauth import keys_of

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Declarer = Annotated[Call, Depends(authenticated_within(SCOPE_BYTES))]


def _redirect(value: str) -> str:
    if not may_be_registered(value):
        raise ValueError("neither an https URI nor an http one of loopback")
    return value


Redirect = Annotated[str, Field(max_length=REDIRECT_BYTES), AfterValidator(_redirect)]


class ClientBody(wire.Body):
    """A client to register: a public one, or with `key` one that authenticates by `private_key_jwt`."""

    client_id: wire.Name
    name: wire.ShortText
    sponsor: wire.Name
    redirect_uris: Annotated[list[Redirect], Field(max_length=REDIRECTS)]
    key: wire.KeyText | None = None


class ScopeBody(wire.Body):
    """The meaning of an OAuth scope: words for people, its one audience, and what it allows there."""

    words: wire.Text
    audience: wire.Url
    grants: list[Any]
    ceiling: Annotated[int, Field(ge=0, le=1)]


@router.post("/oauth/clients", status_code=201, openapi_extra=body_of(ClientBody))
async def register_client(request: Request, call: Caller) -> dict[str, str]:
    """An administrator registers a client, with the agent that stands for it."""
    keys_of(request)
    body = call.body(ClientBody)
    command = RegisterClient(
        by=call.party.id,
        client_id=body.client_id,
        name=body.name,
        sponsor=body.sponsor,
        redirects=tuple(body.redirect_uris),
        key=None if body.key is None else unb64u(body.key),
        # Nobody keeps the private half: what the agent holds can be used through access tokens alone.
        agent_key=public_raw(generate()),
        signed=call.signed,
    )
    await provider_of(request).run(command, actor=call.party.id)
    return {
        "client_id": body.client_id,
        "token_endpoint_auth_method": "none" if body.key is None else "private_key_jwt",
    }


@router.get("/oauth/clients")
async def list_clients(request: Request, call: Caller) -> list[dict[str, Any]]:  # noqa: ARG001  being registered is all that is asked
    """Every registered client, for every registered caller."""
    keys_of(request)
    query_of(request)
    async with provider_of(request).store.read() as view:
        found = await view.oauth.clients()
    return [
        {
            "client_id": client.client_id,
            "name": client.name,
            "redirect_uris": list(client.redirects),
            "token_endpoint_auth_method": "none" if client.key is None else "private_key_jwt",
        }
        for client in found
    ]


@router.post("/oauth/scopes/{name}", openapi_extra=body_of(ScopeBody))
async def declare_scope(request: Request, name: str, call: Declarer) -> dict[str, str]:
    """A sponsor or administrator declares what an OAuth scope allows."""
    keys_of(request)
    body = call.body(ScopeBody)
    if SCOPE_NAME.fullmatch(name) is None:
        raise Problem(IdpCode.SCOPE_UNKNOWN, "a name of a-z, 0-9 and . _ : - with at most 64 characters")
    limits = canonical({"grants": body.grants, "ceiling": body.ceiling}).decode()
    command = DeclareTemplate(call.party.id, name, body.words, body.audience, limits, call.signed)
    await provider_of(request).run(command, actor=call.party.id)
    return {"name": name, "audience": body.audience}


@router.post("/oauth/scopes/{name}/end", openapi_extra=body_of(wire.NothingBody))
async def end_scope(request: Request, name: str, call: Caller) -> dict[str, str]:
    """Nobody is lent by this scope from now on."""
    keys_of(request)
    call.body(wire.NothingBody)
    await provider_of(request).run(EndTemplate(call.party.id, name[:64], call.signed), actor=call.party.id)
    return {"name": name[:64]}


@router.get("/oauth/scopes")
async def list_scopes(request: Request, call: Caller) -> list[dict[str, Any]]:  # noqa: ARG001  being registered is all that is asked
    """Every declared scope, for every registered caller."""
    keys_of(request)
    query_of(request)
    async with provider_of(request).store.read() as view:
        found = await view.oauth.templates()
    return [
        {
            "name": one.name,
            "words": one.words,
            "audience": one.audience,
            "declared_by": one.by,
            **parse_object(one.limits.encode()),
        }
        for one in found
    ]


@router.get("/oauth/lent")
async def list_lent(request: Request, call: Caller) -> list[dict[str, Any]]:
    """Families that the caller lent to clients, the newest first; those of every person for an administrator."""
    keys_of(request)
    query_of(request)
    sees_all = isinstance(call.party, RegisteredPerson) and PersonRole.ADMIN in call.party.roles
    async with provider_of(request).store.read() as view:
        found = await view.oauth.families_of(None if sees_all else call.party.id)
    at_s = provider_of(request).now_ms() // 1_000
    return [
        {
            "id": one.family,
            "client_id": one.client_id,
            "agent": one.agent,
            "sponsor": one.sponsor,
            "resource": one.resource,
            "scope": one.scope,
            "not_after": one.not_after,
            "state": "ended" if one.ended else "over" if not at_s < one.not_after else "in force",
        }
        for one in found
    ]


@router.post("/oauth/lent/{family}/end", openapi_extra=body_of(wire.ReasonBody))
async def end_lent(request: Request, family: str, call: Caller) -> dict[str, int]:
    """The person who lent, or an administrator, takes it back; every access token of it is revoked."""
    keys_of(request)
    body = call.body(wire.ReasonBody)
    if ID.fullmatch(family) is None:
        raise Problem(IdpCode.FAMILY_UNKNOWN)
    done = await provider_of(request).run(EndFamily(call.party.id, family, body.reason), actor=call.party.id)
    return {"epoch": done.epoch}

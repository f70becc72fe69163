"""Agents, enforcement points, sensors, tools; attestation of agents; their trust."""

from __future__ import annotations

import secrets
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import PlainTextResponse

from capabilities.keys.keys import unb64u
from capabilities.statements import revocation
from capabilities.values import text
from capabilities.values.errors import ScopeError, StatementError
from capabilities.values.scope import Tier
from ztpm_idp.domain import commands
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import RegisteredAgent, RegisteredTool
from ztpm_idp.provider import wire
from ztpm_idp.provider.feed import registry_snapshot
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    SMALL_BYTES,
    Call,
    authenticated,
    body_of,
    commanding_within,
    in_session,
    provider_of,
    query_of,
)
from ztpm_idp.routes.described import query

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Bound = Annotated[Call, Depends(in_session())]
Attesting = Annotated[Call, Depends(commanding_within(SMALL_BYTES), scope="function")]


@router.post("/agents", status_code=201, openapi_extra=body_of(wire.AgentBody))
async def register_agent(request: Request, call: Bound) -> dict[str, str]:
    """A sponsor, or an administrator for one, registers an agent."""
    body = call.body(wire.AgentBody)
    command = commands.RegisterAgent(
        by=call.party.id,
        id=body.id,
        key=unb64u(body.key),
        software_digest=bytes.fromhex(body.software_digest),
        model=body.model,
        role=body.role,
        sponsor=body.sponsor,
        workload=body.workload,
    )
    await provider_of(request).run(command, actor=call.party.id, session_key=call.session_key)
    return {"id": body.id, "status": "registered"}


@router.get("/agents")
async def list_agents(request: Request, call: Bound) -> list[dict[str, Any]]:  # noqa: ARG001  being registered is all that is asked
    """Every agent, for every registered caller.

    `trust_by` has the score of each delegator that is not the policy's prior, as enforcement points are told of it;
    `conduct` is its known behaviour, or null when nothing was reported; `held` ones wait for an administrator
    since a restore.
    """
    async with provider_of(request).store.read() as view:
        found = await view.all_parties("agent")
        scores, standings = await view.conduct.everybody()
    return [
        {
            "id": a.id,
            "status": a.standing.value,
            "held": a.held,
            "sponsor": a.sponsor,
            "role": a.role,
            "model": a.model,
            "software_digest": a.software_digest.hex(),
            "key": a.thumbprint,
            "trust_permille": a.trust_permille,
            "workload": a.workload,
            "trust_by": scores.get(a.id, {}),
            "conduct": standings.get(a.id),
        }
        for a in found
        if isinstance(a, RegisteredAgent)
    ]


@router.post("/agents/{id_}/attestations", openapi_extra=body_of(wire.EvidenceBody))
async def attest(request: Request, id_: str, call: Attesting) -> dict[str, str]:
    """Attests an agent's key and software; it is active from then on."""
    body = call.body(wire.EvidenceBody)
    command = commands.Attest(call.party.id, id_, body.evidence)
    await provider_of(request).run(command, actor=call.party.id, once=call.once)
    return {"id": id_, "status": "active"}


@router.post("/agents/{id_}/suspend", openapi_extra=body_of(wire.ReasonBody))
async def suspend_agent(request: Request, id_: str, call: Bound) -> dict[str, str]:
    """The agent's sponsor, or an administrator, suspends it, and all authority through it, until it is restored."""
    body = call.body(wire.ReasonBody)
    await provider_of(request).run(
        commands.SuspendAgent(call.party.id, id_, body.reason), actor=call.party.id, session_key=call.session_key
    )
    return {"id": id_, "status": "suspended"}


@router.post("/agents/{id_}/retire", openapi_extra=body_of(wire.ReasonBody))
async def retire_agent(request: Request, id_: str, call: Bound) -> dict[str, int]:
    """The agent and everything below it are dead, for ever."""
    return await end(request, call, RevocationKind.AGENT, id_)


@router.post("/agents/{id_}/trust", openapi_extra=body_of(wire.TrustBody))
async def state_trust(request: Request, id_: str, call: Bound) -> dict[str, Any]:
    """The agent's sponsor, or an administrator, states its trust."""
    body = call.body(wire.TrustBody)
    await provider_of(request).run(
        commands.StateTrust(call.party.id, id_, body.permille), actor=call.party.id, session_key=call.session_key
    )
    return {"id": id_, "trust_permille": body.permille}


@router.post("/peps", status_code=201, openapi_extra=body_of(wire.PepBody))
async def register_pep(request: Request, call: Caller) -> dict[str, str]:
    """An administrator registers an enforcement point."""
    body = call.body(wire.PepBody)
    command = commands.RegisterPep(call.party.id, body.id, unb64u(body.key), frozenset(body.audiences))
    await provider_of(request).run(command, actor=call.party.id)
    return {"id": body.id}


@router.post("/sensors", status_code=201, openapi_extra=body_of(wire.SensorBody))
async def register_sensor(request: Request, call: Caller) -> dict[str, str]:
    """An administrator registers a sensor."""
    body = call.body(wire.SensorBody)
    command = commands.RegisterSensor(
        call.party.id, body.id, unb64u(body.key), bytes.fromhex(body.calibration), body.transit_ms, body.audience
    )
    await provider_of(request).run(command, actor=call.party.id)
    return {"id": body.id}


@router.post("/tools", status_code=201, openapi_extra=body_of(wire.ToolBody))
async def register_tool(request: Request, call: Caller) -> dict[str, str]:
    """An administrator registers a tool's reviewed definition, or replaces it."""
    body = call.body(wire.ToolBody)
    tool = RegisteredTool(
        body.audience, body.name, bytes.fromhex(body.definition_digest), body.operation, Tier(body.base_tier)
    )
    await provider_of(request).run(commands.RegisterTool(call.party.id, tool), actor=call.party.id)
    return {"name": body.name}


@router.post("/nonces", status_code=201, openapi_extra=body_of(wire.NothingBody))
async def give_nonce(request: Request, call: Attesting) -> dict[str, Any]:
    """A fresh nonce for the calling agent's next evidence."""
    call.body(wire.NothingBody)
    provider = provider_of(request)
    nonce = secrets.token_urlsafe(24)
    await provider.run(commands.GiveNonce(call.party.id, nonce), actor=call.party.id, once=call.once)
    return {"nonce": nonce, "expires_at": provider.now_ms() // 1_000 + provider.rules.nonce_age_s}


@router.get("/registry", openapi_extra=query("audience"), response_class=PlainTextResponse)
async def registry(request: Request, call: Caller) -> PlainTextResponse:  # noqa: ARG001  being registered is all that is asked
    """The signed registry snapshot for one audience, for every registered caller."""
    (audience,) = query_of(request, "audience")
    try:
        text.url(audience, most_bytes=wire.URL_BYTES)
    except ScopeError:
        raise Problem(IdpCode.QUERY_MALFORMED, "audience") from None
    return PlainTextResponse(
        await registry_snapshot(provider_of(request), audience=audience), headers={"Cache-Control": "no-store"}
    )


async def end(request: Request, call: Call, kind: RevocationKind, id_: str) -> dict[str, int]:
    """The party is dead, for ever; the epoch."""
    reason = call.body(wire.ReasonBody).reason
    try:
        revocation.check_id(kind, id_)
    except StatementError:
        raise Problem(IdpCode.NOT_FOUND) from None
    done = await provider_of(request).run(
        commands.Revoke(call.party.id, kind, id_, reason), actor=call.party.id, session_key=call.session_key
    )
    return {"epoch": done.epoch}

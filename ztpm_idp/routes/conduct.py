"""Conduct of agents: the statement for enforcement points, and a person's restoration of an agent."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import PlainTextResponse

from ztpm_idp.domain import commands
from ztpm_idp.provider import wire
from ztpm_idp.provider.heartbeat import conduct_word
from ztpm_idp.routes.caller import (
    Call,
    authenticated,
    body_of,
    heartbeat_of,
    nonce_of,
    provider_of,
    query_of,
    since_of,
)
from ztpm_idp.routes.described import query

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]


@router.get("/conduct", response_class=PlainTextResponse, openapi_extra=query("since", "nonce"))
async def conduct(request: Request, call: Caller) -> PlainTextResponse:  # noqa: ARG001  being registered is all that is asked
    """The signed word on conduct after a version, echoing the caller's nonce, for every registered caller.

    Only a store that can commit answers.
    """
    since, nonce = query_of(request, "since", "nonce")
    known, echoed = since_of(since), nonce_of(nonce)
    text = await conduct_word(provider_of(request), heartbeat_of(request), since=known, nonce=echoed)
    return PlainTextResponse(text, headers={"Cache-Control": "no-store"})


@router.post("/agents/{id_}/restore", openapi_extra=body_of(wire.RestoreBody))
async def restore_agent(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """The agent's sponsor, or an administrator, ends its suspension and takes its deviations off it."""
    body = call.body(wire.RestoreBody)
    command = commands.RestoreAgent(call.party.id, id_, body.reason, body.relearn)
    await provider_of(request).run(command, actor=call.party.id)
    return {"id": id_, "status": "restored"}

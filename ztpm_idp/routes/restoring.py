"""Restoring: enforcement points tell what they know to be revoked, an administrator resumes and vouches for agents."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request

from ztpm_idp.domain import commands
from ztpm_idp.provider import wire
from ztpm_idp.provider.body_json import BODY_BYTES
from ztpm_idp.routes.caller import Call, authenticated, authenticated_within, body_of, provider_of

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Point = Annotated[Call, Depends(authenticated_within(BODY_BYTES))]


@router.post("/restoring/marks", openapi_extra=body_of(wire.MarkBody))
async def take_mark(request: Request, call: Point) -> dict[str, bool]:
    """An enforcement point's mark, or a part of it, is taken; offering it again changes nothing."""
    text = call.body(wire.MarkBody).mark
    await provider_of(request).run(commands.TakeMark(call.party.id, text), actor=call.party.id)
    return {"taken": True}


@router.post("/restoring/resume", openapi_extra=body_of(wire.ResumeBody))
async def resume(request: Request, call: Caller) -> dict[str, bool]:
    """An administrator ends the restore, and names exactly the enforcement points that were not heard."""
    unheard = frozenset(call.body(wire.ResumeBody).unheard)
    await provider_of(request).run(commands.ResumeStore(call.party.id, unheard, call.signed), actor=call.party.id)
    return {"resumed": True}


@router.post("/agents/{id_}/vouch", openapi_extra=body_of(wire.ReasonBody))
async def vouch(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """An administrator vouches for an agent that is held since a restore."""
    reason = call.body(wire.ReasonBody).reason
    await provider_of(request).run(commands.VouchAgent(call.party.id, id_, reason), actor=call.party.id)
    return {"id": id_}

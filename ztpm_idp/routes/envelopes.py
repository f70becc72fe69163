"""Envelopes: an approver approves beforehand, lists, and revokes."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import JSONResponse

from capabilities.statements.claims import ID
from ztpm_idp.domain.asking.asks import stated
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.commands import RevokeEnvelope, SignEnvelope
from ztpm_idp.domain.parties import RegisteredPerson
from ztpm_idp.provider import wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import Call, authenticated, body_of, provider_of

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
_UNSTORED = {"Cache-Control": "no-store"}


@router.post("/envelopes", status_code=201, openapi_extra=body_of(wire.EnvelopeBody))
async def sign_envelope(request: Request, call: Caller) -> JSONResponse:
    """An approver approves beforehand: 201, or 200 when the very same was taken before."""
    text, provider = call.body(wire.EnvelopeBody).envelope, provider_of(request)
    done = await provider.run(SignEnvelope(call.party.id, text, call.signed), actor=call.party.id)
    envelope_id = stated(text, provider.rules.caps)["envelope_id"]
    return JSONResponse({"envelope_id": envelope_id}, status_code=201 if done.events else 200, headers=_UNSTORED)


@router.get("/envelopes")
async def list_envelopes(request: Request, call: Caller) -> JSONResponse:
    """The envelopes that are not over, as they were signed, for people."""
    if not isinstance(call.party, RegisteredPerson):
        raise Problem(IdpCode.NOT_PERMITTED, "people read envelopes")
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        found = await view.envelopes.lasting(since_s=at_ms // 1_000)
    rows = [
        {
            "envelope_id": envelope.envelope_id,
            "approver": envelope.approver,
            "audience": envelope.audience,
            "agent": envelope.agent,
            "not_before": envelope.not_before,
            "not_after": envelope.not_after,
            "envelope": envelope.text,
        }
        for envelope in found
        if not envelope.over(at_ms)
    ]
    return JSONResponse(rows, headers=_UNSTORED)


@router.post("/envelopes/{envelope_id}/revoke", openapi_extra=body_of(wire.ReasonBody))
async def revoke_envelope(request: Request, envelope_id: str, call: Caller) -> dict[str, str]:
    """The envelope is over."""
    reason = call.body(wire.ReasonBody).reason
    if not ID.fullmatch(envelope_id):
        raise Problem(IdpCode.ENVELOPE_UNKNOWN)
    await provider_of(request).run(RevokeEnvelope(call.party.id, envelope_id, reason), actor=call.party.id)
    return {"envelope_id": envelope_id}

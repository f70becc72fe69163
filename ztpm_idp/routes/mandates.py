"""Mandates: sponsors sign them, agents draw tokens from them, and both see each draw."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import JSONResponse

from capabilities.keys.keys import b64u
from capabilities.statements.claims import ID
from capabilities.statements.people import mandate as mandate_statement
from capabilities.values.scope_json import scope_to_json
from ztpm_idp.domain import commands
from ztpm_idp.domain.asking.asks import stated
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.lending.mandates import standing
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson
from ztpm_idp.domain.state import Wanted
from ztpm_idp.provider import wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    ASK_BYTES,
    Call,
    authenticated,
    authenticated_within,
    body_of,
    in_session,
    provider_of,
    query_of,
)
from ztpm_idp.routes.tokens import digest_of_request, made
from ztpm_idp.store.lending import SHOWN

if TYPE_CHECKING:
    from ztpm_idp.domain.state import State
    from ztpm_idp.store.transaction import Transaction

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Bound = Annotated[Call, Depends(in_session())]
Promiser = Annotated[Call, Depends(authenticated_within(ASK_BYTES))]
_UNSTORED = {"Cache-Control": "no-store"}


@router.post("/mandates", status_code=201, openapi_extra=body_of(wire.MandateBody))
async def sign_mandate(request: Request, call: Promiser) -> JSONResponse:
    """A sponsor's mandate is in force: 201, or 200 when the very same was signed before."""
    text, provider = call.body(wire.MandateBody).mandate, provider_of(request)
    done = await provider.run(commands.SignMandate(call.party.id, text, call.signed), actor=call.party.id)
    mandate_id = stated(text, provider.rules.caps)["mandate_id"]
    return JSONResponse({"mandate_id": mandate_id}, status_code=201 if done.events else 200, headers=_UNSTORED)


@router.get("/mandates")
async def list_mandates(request: Request, call: Bound) -> JSONResponse:
    """Mandates that the caller signed or may draw from, the newest first; every one for an administrator."""
    query_of(request)
    async with provider_of(request).store.read() as view:
        found = await view.lending.mandates_of(None if _sees_all(call) else call.party.id)
        rows = [await _row(request, view, mandate.mandate_id) for mandate in found]
    return JSONResponse(rows, headers=_UNSTORED)


@router.get("/mandates/{mandate_id}")
async def read_mandate(request: Request, mandate_id: str, call: Bound) -> JSONResponse:
    """A mandate as it was signed, how it stands, and the newest tokens that were drawn from it."""
    async with provider_of(request).store.read() as view:
        mandate = await view.lending.mandate(mandate_id) if ID.fullmatch(mandate_id) else None
        if mandate is None or not (_sees_all(call) or call.party.id in {mandate.sponsor, mandate.agent}):
            raise Problem(IdpCode.MANDATE_UNKNOWN)
        row = await _row(request, view, mandate_id)
        drawn = await view.lending.drawn(mandate_id)
    at_ms = provider_of(request).now_ms()
    draws = [
        {
            "token_id": token.token_id,
            "hop_id": token.hop_id,
            "drawn_at": token.drawn_ms // 1_000,
            "not_after": token.not_after,
            "live": token.live(at_ms),
        }
        for token in drawn[:SHOWN]
    ]
    answer = row | {
        "scope": scope_to_json(mandate_statement.read_again(mandate.text).scope),
        "mandate": mandate.text,
        "draws": draws,
    }
    return JSONResponse(answer, headers=_UNSTORED)


@router.post("/mandates/{mandate_id}/tokens", status_code=201, openapi_extra=body_of(wire.DrawBody))
async def draw_token(request: Request, mandate_id: str, call: Caller) -> dict[str, object]:
    """The calling agent draws a token; nobody is asked."""
    body, provider = call.body(wire.DrawBody), provider_of(request)
    if body.request.mandate_id != mandate_id:
        raise Problem(IdpCode.MANDATE_UNKNOWN)
    command = commands.DrawToken(
        by=call.party.id,
        mandate_id=mandate_id,
        lifetime_s=body.request.lifetime_s,
        request_digest=digest_of_request(body.request),
        evidence=body.evidence,
        token_id=b64u(secrets.token_bytes(16)),
        hop_id=secrets.token_hex(16),
        signed=call.signed,
    )
    return made(await provider.run(command, actor=call.party.id))


def _sees_all(call: Call) -> bool:
    return isinstance(call.party, RegisteredPerson) and bool(call.party.roles & {PersonRole.ADMIN, PersonRole.AUDITOR})


async def _row(request: Request, view: Transaction, mandate_id: str) -> dict[str, object]:
    at_ms = provider_of(request).now_ms()
    state = await view.load(Wanted(mandate=mandate_id), young_ms=at_ms)
    return _told(state, at_ms)


def _told(state: State, at_ms: int) -> dict[str, object]:
    mandate = state.mandate
    if mandate is None:
        raise Problem(IdpCode.MANDATE_UNKNOWN)
    return {
        "mandate_id": mandate.mandate_id,
        "state": standing(state, mandate, at_ms).value,
        "sponsor": mandate.sponsor,
        "agent": mandate.agent,
        "purpose": mandate_statement.read_again(mandate.text).purpose,
        "signed_at": mandate.signed_at,
        "not_after": mandate.not_after,
        "live": sum(token.live(at_ms) for token in state.drawn),
    }

"""The ledger: taking in enforcement points' journals, and giving out the whole for offline verification."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse

from capabilities.statements.people.picture import digest_of
from capabilities.values.units import INT_LIMIT
from ztpm_idp.domain import commands
from ztpm_idp.domain.audit import may_audit
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.pictures import DIGEST
from ztpm_idp.provider import wire
from ztpm_idp.provider.body_json import BODY_BYTES
from ztpm_idp.provider.feed import ledger_export
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    PICTURED_BYTES,
    Call,
    authenticated,
    authenticated_within,
    body_of,
    in_session,
    provider_of,
    query_of,
    since_of,
)
from ztpm_idp.routes.described import media, query

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Bound = Annotated[Call, Depends(in_session())]
Batch = Annotated[Call, Depends(authenticated_within(BODY_BYTES))]
Pictured = Annotated[Call, Depends(authenticated_within(PICTURED_BYTES))]


@router.post("/ledger/records", openapi_extra=body_of(wire.RecordsBody))
async def take_records(request: Request, call: Batch) -> dict[str, int]:
    """An enforcement point's records are in the ledger; offering them again changes nothing."""
    records = tuple(call.body(wire.RecordsBody).records)
    await provider_of(request).run(commands.TakeRecords(call.party.id, records), actor=call.party.id)
    return {"accepted_through": int(records[-1]["seq"])}


@router.post("/ledger/pictures", status_code=201, openapi_extra=body_of(wire.PictureBody))
async def take_picture(request: Request, call: Pictured) -> JSONResponse:
    """A picture that a record in the ledger names is kept: 201, or 200 when it was here before."""
    text = call.body(wire.PictureBody).picture
    done = await provider_of(request).run(commands.TakePicture(call.party.id, text), actor=call.party.id)
    return JSONResponse({"digest": digest_of(text)}, status_code=201 if done.events else 200)


@router.get("/ledger/pictures/{digest}")
async def read_picture(request: Request, digest: str, call: Bound) -> Response:
    """The picture with this SHA-256 (hex), byte for byte, for those who read the ledger."""
    if not may_audit(call.party):
        raise Problem(IdpCode.NOT_PERMITTED)
    return await picture_of(request, digest)


async def picture_of(request: Request, digest: str) -> Response:
    """The picture with this SHA-256 (hex), byte for byte.

    Raises:
        Problem: `PICTURE_UNKNOWN`, or `PICTURE_AWAITED` while it is only named.
    """
    async with provider_of(request).store.read() as view:
        text = await view.pictures.text(digest) if DIGEST.fullmatch(digest) else None
    if not text:
        raise Problem(IdpCode.PICTURE_UNKNOWN if text is None else IdpCode.PICTURE_AWAITED)
    headers = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}
    return Response(text, media_type="application/json", headers=headers)


@router.get(
    "/ledger/export",
    response_class=StreamingResponse,
    openapi_extra=query(optional=("first", "last")) | media("application/x-ndjson"),
)
async def export(request: Request, call: Bound) -> StreamingResponse:
    """Every entry as one JSON line, then the signed checkpoint of the last.

    With `first` and `last`, which are given together, the entries of that range.
    """
    if not may_audit(call.party):
        raise Problem(IdpCode.NOT_PERMITTED)
    first, last = map(since_of, query_of(request, "first", "last")) if request.query_params else (1, INT_LIMIT)
    if not 1 <= first <= last:
        raise Problem(IdpCode.QUERY_MALFORMED, "first and last")
    return StreamingResponse(
        ledger_export(provider_of(request), first=first, last=last),
        media_type="application/x-ndjson",
        headers={"Cache-Control": "no-store"},
    )

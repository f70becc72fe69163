"""The ledger: taking in enforcement points' journals, and giving out the whole for offline verification."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import StreamingResponse

from capabilities.values.units import INT_LIMIT
from ztpm_idp.domain import commands
from ztpm_idp.domain.audit import may_audit
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider import wire
from ztpm_idp.provider.body_json import BODY_BYTES
from ztpm_idp.provider.feed import ledger_export
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
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


@router.post("/ledger/records", openapi_extra=body_of(wire.RecordsBody))
async def take_records(request: Request, call: Batch) -> dict[str, int]:
    """An enforcement point's records are in the ledger; offering them again changes nothing."""
    records = tuple(call.body(wire.RecordsBody).records)
    await provider_of(request).run(commands.TakeRecords(call.party.id, records), actor=call.party.id)
    return {"accepted_through": int(records[-1]["seq"])}


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

"""Latches of robots: an enforcement point tells of one, people read, and approvers clear it, by key or by passkey."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, JSONResponse

from capabilities.keys.keys import b64u
from capabilities.statements import claims
from capabilities.statements.claims import ID
from capabilities.statements.people import latch as latches
from capabilities.statements.people import passkey_clearing
from capabilities.statements.people.clearing import Clearing
from capabilities.values.errors import StatementError
from ztpm_idp.domain.asking.asks import stated
from ztpm_idp.domain.asking.latch_acts import ClearingSigned
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.commands import ClearLatch, TakeLatch
from ztpm_idp.domain.parties import RegisteredPerson
from ztpm_idp.provider import latch_page, passkeys, wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import SMALL_BYTES, Call, authenticated, body_of, parsed, provider_of, read_body

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm_idp.domain.asking.latch_acts import ClearingRecord, LatchRecord
    from ztpm_idp.domain.events import Event

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
_UNSTORED: Final = {"Cache-Control": "no-store"}
SHOWN: Final = 64
"""Most latches of one list, the newest."""


@router.post("/latches", status_code=201, openapi_extra=body_of(wire.LatchBody))
async def take_latch(request: Request, call: Caller) -> JSONResponse:
    """An enforcement point tells of its latch: 201, or 200 when the very same waits already."""
    text, provider = call.body(wire.LatchBody).latch, provider_of(request)
    done = await provider.run(TakeLatch(call.party.id, text), actor=call.party.id)
    request.app.state.pushing.told()
    latch_id = stated(text, provider.rules.caps)["latch_id"]
    return JSONResponse({"latch_id": latch_id}, status_code=201 if done.events else 200, headers=_UNSTORED)


@router.get("/latches")
async def list_latches(request: Request, call: Caller) -> JSONResponse:
    """The newest latches, for people."""
    _only_people(call)
    async with provider_of(request).store.read() as view:
        found = await view.latches.newest(SHOWN)
    rows = [
        {
            "latch_id": latch.latch_id,
            "state": _state(latch),
            "pep": latch.pep,
            "audience": latch.audience,
            "robot": latch.robot,
            "cause": latch.cause,
            "approvers": latch.approvers,
            "at": latch.at,
        }
        for latch in found
    ]
    return JSONResponse(rows, headers=_UNSTORED)


@router.get("/latches/{latch_id}")
async def show_latch(request: Request, latch_id: str, call: Caller) -> JSONResponse:
    """One latch as its enforcement point signed it, and the people who have cleared it, for people."""
    _only_people(call)
    latch, clearings, key = await _found(request, latch_id)
    at_ms = provider_of(request).now_ms()
    answer = {
        "latch": latch.text,
        "state": _state(latch),
        "pep_key": b64u(key),
        "clearings": [
            {"approver": each.approver, "not_after": each.not_after, "counts": each.counts(latch, at_ms)}
            for each in clearings
        ],
    }
    return JSONResponse(answer, headers=_UNSTORED)


@router.get("/latches/{latch_id}/page", response_class=HTMLResponse)
async def latch_page_of(request: Request, latch_id: str) -> HTMLResponse:
    """Shows the latch as a plain page, with the ways to clear it.

    Anyone with the link can read it, as the page of an ask: the id is 128 random bits, and a clearing needs an
    approver's key or passkey.
    """
    provider = provider_of(request)
    latch, clearings, key = await _found(request, latch_id)
    shown = latches.open(latch.text, {key}, provider.rules.caps)
    page = latch_page.render(shown, latch, clearings, at_ms=provider.now_ms())
    return HTMLResponse(page, headers=_UNSTORED | latch_page.headers(provider.settings.issuer))


@router.post("/latches/{latch_id}/clearings", status_code=201, openapi_extra=body_of(wire.ClearingBody))
async def clear_latch(request: Request, latch_id: str, call: Caller) -> JSONResponse:
    """An approver clears the latch; how it stands after it."""
    text, provider = call.body(wire.ClearingBody).clearing, provider_of(request)
    if not ID.fullmatch(latch_id):
        raise Problem(IdpCode.LATCH_UNKNOWN)
    done = await provider.run(ClearLatch(call.party.id, latch_id, text, call.signed), actor=call.party.id)
    return await _cleared(request, latch_id, done.events)


@router.post("/latches/{latch_id}/passkey-clearings", status_code=201, openapi_extra=body_of(wire.PasskeyClearingBody))
async def clear_by_passkey(request: Request, latch_id: str) -> JSONResponse:
    """An approver clears the latch by passkey.

    The assertion is the caller's proof: it binds this latch and the approver, and counts once. What no passkey of an
    active person made leaves no trace.
    """
    provider = provider_of(request)
    body = parsed(wire.PasskeyClearingBody, await read_body(request, body_bytes=SMALL_BYTES))
    party = passkeys.party_of(provider)
    found, (latch, _, key) = await passkeys.asserted(provider, body.assertion), await _found(request, latch_id)
    try:
        made = passkey_clearing.compose(claims.read(Clearing, body.clearing), found.assertion, key=found.key)
        shown = latches.open(latch.text, {key}, provider.rules.caps)
        passkey_clearing.open(made, {found.key}, latch=shown, party=party)
    except StatementError as error:
        raise Problem(error.code, error.detail) from None
    done = await provider.run(ClearLatch(found.person.id, latch_id, made, None), actor=found.person.id)
    return await _cleared(request, latch_id, done.events)


async def _cleared(request: Request, latch_id: str, events: Iterable[Event]) -> JSONResponse:
    """State of the latch; what was signed now is not read again, since a reading may fail after it counts."""
    signed = next((event for event in events if isinstance(event, ClearingSigned)), None)
    latch = signed or (await _found(request, latch_id))[0]
    told = {"latch_id": latch_id, "state": _state(latch)}
    return JSONResponse(told, status_code=201 if signed else 200, headers=_UNSTORED)


WAITS: Final = "waits"
RELEASED: Final = "released"
"""States of a latch: it waits for people, or enough of them have cleared it."""


def _state(latch: LatchRecord | ClearingSigned) -> str:
    return RELEASED if latch.released else WAITS


async def _found(request: Request, latch_id: str) -> tuple[LatchRecord, tuple[ClearingRecord, ...], bytes]:
    """The latch, its clearings, and the key of the enforcement point that signed it."""
    async with provider_of(request).store.read() as view:
        latch = await view.latches.one(latch_id) if ID.fullmatch(latch_id) else None
        if latch is None:
            raise Problem(IdpCode.LATCH_UNKNOWN)
        return latch, await view.latches.clearings(latch_id), await view.latches.signer(latch_id)


def _only_people(call: Call) -> None:
    if not isinstance(call.party, RegisteredPerson):
        raise Problem(IdpCode.NOT_PERMITTED, "people read latches")

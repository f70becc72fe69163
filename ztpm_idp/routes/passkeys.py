"""Passkeys: a person enrols one with a browser and proposes it by its own key; an approver votes with one."""

from __future__ import annotations

import secrets
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from capabilities.keys.keys import b64u, unb64u
from capabilities.statements import claims
from capabilities.statements.claims import ID
from capabilities.statements.people import ask, passkey_vote
from capabilities.statements.people.vote import Vote
from capabilities.values.errors import StatementError
from ztpm_idp.domain import commands
from ztpm_idp.domain.changes import ChangeKind
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import VoteCast
from ztpm_idp.domain.parties import RegisteredPerson, Standing
from ztpm_idp.provider import ask_page, passkeys, wire
from ztpm_idp.provider.body_json import BodyError
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.approvals import found_ask
from ztpm_idp.routes.caller import SMALL_BYTES, Call, authenticated, body_of, provider_of, read_body
from ztpm_idp.routes.people import change_of, propose
from ztpm_idp.store.login.enrolments import Enrolment

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
ENROLMENT_MS: Final = 600_000
"""Milliseconds for which an enrolment is open: the way from a terminal to a phone, and no more."""
OPEN_ENROLMENTS: Final = 4
"""Most open enrolments of one person."""
_UNSTORED: Final = {"Cache-Control": "no-store"}


@router.get("/passkeys/passkey.js", response_class=Response)
async def script() -> Response:
    """The one script of the pages with passkeys."""
    headers = {"X-Content-Type-Options": "nosniff", "Cache-Control": "no-cache"}
    return Response(ask_page.SCRIPT, media_type="text/javascript", headers=headers)


@router.post("/passkeys/enrolments", status_code=201, openapi_extra=body_of(wire.NothingBody))
async def begin(request: Request, call: Caller) -> JSONResponse:
    """A person begins to make a passkey of its own; the page for it, open for ten minutes."""
    call.body(wire.NothingBody)
    provider, person = provider_of(request), _person(call)
    passkeys.party_of(provider)
    at_ms = provider.now_ms()
    enrolment = Enrolment(secrets.token_hex(16), person.id, at_ms + ENROLMENT_MS, None, None)
    async with provider.store.write() as transaction:
        begun = await transaction.enrolments.begin(enrolment, at_ms=at_ms, most=OPEN_ENROLMENTS)
    if not begun:
        raise Problem(IdpCode.TOO_MANY_ENROLMENTS, f"{OPEN_ENROLMENTS} are open")
    answer = {
        "enrolment_id": enrolment.enrolment_id,
        "url": f"{provider.settings.issuer}/passkeys/enrolments/{enrolment.enrolment_id}/page",
        "expires_at": enrolment.expires_ms // 1_000,
    }
    return JSONResponse(answer, status_code=201, headers=_UNSTORED)


@router.get("/passkeys/enrolments/{enrolment_id}")
async def read_enrolment(request: Request, enrolment_id: str, call: Caller) -> JSONResponse:
    """The credential that a browser has made, for the person who began the enrolment; its key is empty until then."""
    enrolment = await _enrolment(request, enrolment_id)
    if enrolment.person != call.party.id:
        raise Problem(IdpCode.ENROLMENT_UNKNOWN)
    key = "" if enrolment.key is None else b64u(enrolment.key)
    return JSONResponse({"enrolment_id": enrolment_id, "key": key}, headers=_UNSTORED)


@router.get("/passkeys/enrolments/{enrolment_id}/page", response_class=HTMLResponse)
async def enrolment_page(request: Request, enrolment_id: str) -> HTMLResponse:
    """The page on which a browser makes the credential, for everybody who has the link."""
    provider = provider_of(request)
    party, enrolment = passkeys.party_of(provider), await _enrolment(request, enrolment_id)
    async with provider.store.read() as view:
        person = next(p for p in await view.all_parties("person") if p.id == enrolment.person)
    if not isinstance(person, RegisteredPerson) or person.standing is not Standing.ACTIVE:
        raise Problem(IdpCode.ENROLMENT_UNKNOWN)
    page = ask_page.enrolment(
        person.id, provider.settings.issuer, enrolment_id, passkeys.options(party, person, enrolment_id)
    )
    return HTMLResponse(page, headers=_UNSTORED | ask_page.scripted(provider.settings.issuer))


@router.post(
    "/passkeys/enrolments/{enrolment_id}/credential",
    status_code=201,
    openapi_extra=body_of(wire.RegistrationBody),
)
async def make(request: Request, enrolment_id: str) -> JSONResponse:
    """A browser has made the credential; it is nobody's until its person proposes it and another confirms."""
    provider = provider_of(request)
    body = _parsed(wire.RegistrationBody, await read_body(request, body_bytes=SMALL_BYTES))
    party, enrolment = passkeys.party_of(provider), await _enrolment(request, enrolment_id)
    expected = passkeys.enrolment_challenge(enrolment_id, enrolment.person)
    made = passkeys.registered(party, body.credential, expected=expected)
    async with provider.store.write() as transaction:
        kept = await transaction.enrolments.made(enrolment_id, credential=made.id, key=made.key)
    if not kept:
        raise Problem(IdpCode.ENROLMENT_UNKNOWN, "it has its credential")
    return JSONResponse({"key": b64u(made.key)}, status_code=201, headers=_UNSTORED)


@router.post("/changes/passkey", status_code=201, openapi_extra=body_of(wire.PasskeyBody))
async def propose_passkey(request: Request, call: Caller) -> dict[str, str]:
    """A person proposes the passkey that it has enrolled; the request that its own key signed names the new key."""
    body = call.body(wire.PasskeyBody)
    enrolment = await _enrolment(request, body.enrolment_id)
    if enrolment.person != call.party.id or enrolment.key != unb64u(body.key) or enrolment.credential is None:
        raise Problem(IdpCode.ENROLMENT_UNKNOWN, "no credential of the caller with this key")
    change = change_of(
        request,
        ChangeKind.KEY,
        call.party.id,
        by=call.party.id,
        key=enrolment.key,
        credential=enrolment.credential,
    )
    return await propose(request, call, change)


@router.post("/approvals/{ask_id}/passkey-votes", status_code=201, openapi_extra=body_of(wire.PasskeyVoteBody))
async def cast_vote(request: Request, ask_id: str) -> JSONResponse:
    """An approver's answer by passkey is taken; how the ask stands after it.

    The assertion is the caller's proof: it binds this ask, this answer and the approver, and counts once. What no
    passkey of an active person made leaves no trace.
    """
    provider = provider_of(request)
    body = _parsed(wire.PasskeyVoteBody, await read_body(request, body_bytes=SMALL_BYTES))
    party = passkeys.party_of(provider)
    found, (_, text, key) = await passkeys.asserted(provider, body.assertion), await found_ask(request, ask_id)
    try:
        vote = claims.read(Vote, body.vote)
        made = passkey_vote.compose(vote, found.assertion, key=found.key)
        shown = ask.open(text, {key}, provider.rules.caps)
        passkey_vote.open(made, {found.key}, ask=shown, party=party)
    except StatementError as error:
        raise Problem(error.code, error.detail) from None
    command = commands.CastVote(found.person.id, ask_id, made, None, (text, key))
    done = await provider.run(command, actor=found.person.id)
    (state,) = (event.state for event in done.events if isinstance(event, VoteCast))
    return JSONResponse({"ask_id": ask_id, "state": state.value}, status_code=201, headers=_UNSTORED)


def _parsed(model: type[Any], raw: bytes) -> Any:
    try:
        return wire.parse_body(model, raw)
    except BodyError as error:
        raise Problem(error.code, error.detail) from None


def _person(call: Call) -> RegisteredPerson:
    if not isinstance(call.party, RegisteredPerson):
        raise Problem(IdpCode.NOT_PERMITTED, "people have passkeys")
    return call.party


async def _enrolment(request: Request, enrolment_id: str) -> Enrolment:
    provider = provider_of(request)
    async with provider.store.read() as view:
        found = (
            await view.enrolments.found(enrolment_id, at_ms=provider.now_ms()) if ID.fullmatch(enrolment_id) else None
        )
    if found is None:
        raise Problem(IdpCode.ENROLMENT_UNKNOWN)
    return found

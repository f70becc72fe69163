"""Asking people: enforcement points ask and learn the answers, people read, vote, open and close."""

from __future__ import annotations

from importlib import resources
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response

from capabilities import tracing
from capabilities.keys.keys import b64u
from capabilities.statements.claims import ID
from capabilities.statements.people import answers, ask
from ztpm_idp.domain import commands
from ztpm_idp.domain.asking.asks import ANSWERED_MEMORY_S, Asked, AskState, stated
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import VoteCast
from ztpm_idp.domain.parties import RegisteredPep, RegisteredPerson
from ztpm_idp.provider import ask_page, wire
from ztpm_idp.provider.feed import answers_for
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    PICTURED_BYTES,
    Call,
    authenticated,
    authenticated_within,
    body_of,
    in_session,
    nonce_of,
    prefix_of,
    provider_of,
    query_of,
)
from ztpm_idp.routes.described import query

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Bound = Annotated[Call, Depends(in_session())]
Asker = Annotated[Call, Depends(authenticated_within(PICTURED_BYTES))]
_UNSTORED = {"Cache-Control": "no-store"}
_SHARED = resources.files("ztpm_idp.console") / "assets"
_ASSETS = {
    **{name: ((_SHARED / name).read_text("utf-8"), "text/javascript") for name in ask_page.DRAWING},
    **{name: (text, "text/javascript") for name, text in ask_page.SCRIPTS.items()},
    "open_asks.js": (ask_page.LIST_SCRIPT, "text/javascript"),
    ask_page.WORKER: (ask_page.WORKER_SCRIPT, "text/javascript"),
    "console.css": ((_SHARED / "console.css").read_text("utf-8"), "text/css"),
}
"""Files of the pages of asks, passkeys and latches."""


@router.post("/approvals", status_code=201, openapi_extra=body_of(wire.AskBody))
async def take_ask(request: Request, call: Asker) -> JSONResponse:
    """An enforcement point's ask is shown to people: 201, or 200 when the very same was taken before."""
    body, provider = call.body(wire.AskBody), provider_of(request)
    text = body.ask
    command = commands.TakeAsk(call.party.id, text, tracing.trace_id() or "", body.picture)
    done = await provider.run(command, actor=call.party.id)
    request.app.state.pushing.told()
    # It was opened strictly on the way: its id is a safe part of a path.
    ask_id = stated(text, provider.rules.caps)["ask_id"]
    url = f"{provider.settings.issuer}/approvals/{ask_id}/page"
    return JSONResponse({"ask_id": ask_id, "url": url}, status_code=201 if done.events else 200, headers=_UNSTORED)


@router.get("/approvals/answers", response_class=PlainTextResponse, openapi_extra=query("audience", "nonce"))
async def read_answers(request: Request, call: Caller) -> PlainTextResponse:
    """Answers to the asks and openings of an audience, signed, with the nonce, for a PEP that serves it."""
    audience, nonce = query_of(request, "audience", "nonce")
    echoed = nonce_of(nonce)
    if not isinstance(call.party, RegisteredPep) or audience not in call.party.audiences:
        raise Problem(IdpCode.NOT_PERMITTED, "an enforcement point learns the answers to its own audiences")
    return PlainTextResponse(
        await answers_for(provider_of(request), audience=audience, nonce=echoed), headers=_UNSTORED
    )


@router.get("/approvals", openapi_extra=query("state"))
async def list_asks(request: Request, call: Bound) -> JSONResponse:
    """The asks in one state, for people, the oldest first; those that are over for at most ten minutes."""
    _only_people(call)
    (state,) = query_of(request, "state")
    if state not in answers.STATES:
        raise Problem(IdpCode.QUERY_MALFORMED, "state")
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        found = await view.approvals.not_long_over(since_s=at_ms // 1_000 - ANSWERED_MEMORY_S)
        chosen = [asked for asked in found if asked.state(at_ms) is AskState(state)][-answers.ASKS :]
        signed = await view.approvals.signed(frozenset(asked.ask.ask_id for asked in chosen))
    rows = []
    for asked in chosen:
        text, key = signed[asked.ask.ask_id]
        rows.append(_row(asked, ask.open(text, {key}, provider.rules.caps), AskState(state)))
    return JSONResponse(rows, headers=_UNSTORED)


@router.get("/approvals/{ask_id}")
async def read_ask(request: Request, ask_id: str, call: Bound) -> JSONResponse:
    """An ask as it was signed, how it stands, and its votes as they were signed; for people."""
    _only_people(call)
    provider = provider_of(request)
    asked, text, key = await found_ask(request, ask_id)
    answer = {
        "ask": text,
        "state": asked.state(provider.now_ms()).value,
        "votes": [vote.text for vote in asked.votes],
        "expires_at": asked.ask.expires_at,
        "trace_id": asked.ask.trace_id,
        "pep_key": b64u(key),
    }
    return JSONResponse(answer, headers=_UNSTORED)


@router.post("/approvals/{ask_id}/votes", status_code=201, openapi_extra=body_of(wire.VoteBody))
async def cast_vote(request: Request, ask_id: str, call: Caller) -> JSONResponse:
    """A person's answer is taken; how the ask stands after it."""
    text, provider = call.body(wire.VoteBody).vote, provider_of(request)
    if not ID.fullmatch(ask_id):
        raise Problem(IdpCode.ASK_UNKNOWN)
    done = await provider.run(commands.CastVote(call.party.id, ask_id, text, call.signed), actor=call.party.id)
    (state,) = (event.state for event in done.events if isinstance(event, VoteCast))
    return JSONResponse({"ask_id": ask_id, "state": state.value}, status_code=201, headers=_UNSTORED)


@router.get("/approvals/{ask_id}/page", response_class=HTMLResponse)
async def show_ask(request: Request, ask_id: str) -> HTMLResponse:
    """Shows the ask as a plain page: the canonical action, and the ways to answer it.

    Anyone with the link can read it: the ask's id is 128 random bits that the enforcement point made, and the link goes
    to the caller and to people. The page holds no token and no key that opens anything: a vote needs an operator's key,
    or a passkey, which no page holds.
    """
    provider = provider_of(request)
    asked, text, key = await found_ask(request, ask_id)
    at_ms = provider.now_ms()
    shown = ask.open(text, {key}, provider.rules.caps)
    panel, headers = ask_page.panel(text, shown, at_ms=at_ms), ask_page.headers(provider.settings.issuer)
    page = ask_page.render(text, shown, asked, asked.state(at_ms), at_ms=at_ms, passkey=panel)
    return HTMLResponse(page, headers=_UNSTORED | headers)


@router.get("/approvals/assets/{name}", response_class=Response)
async def read_asset(request: Request, name: str) -> Response:
    """One of the files that the pages of asks have: the scripts, and the look."""
    if name not in _ASSETS:
        raise Problem(IdpCode.ASK_UNKNOWN, "no such file")
    content, kind = _ASSETS[name]
    headers = {"X-Content-Type-Options": "nosniff", "Cache-Control": "max-age=300"}
    if name == ask_page.WORKER:
        scope = f"{prefix_of(provider_of(request))}/approvals/"
        headers |= {"Service-Worker-Allowed": scope, "Content-Security-Policy": "default-src 'none'"}
    return Response(content, media_type=kind, headers=headers)


@router.get("/approvals/{ask_id}/picture", response_class=Response)
async def show_picture(request: Request, ask_id: str) -> Response:
    """The picture that the ask names, byte for byte, for everybody who has the link of its page."""
    async with provider_of(request).store.read() as view:
        text = await view.approvals.picture(ask_id) if ID.fullmatch(ask_id) else ""
    if not text:
        raise Problem(IdpCode.ASK_UNKNOWN, "no such ask, or it names no picture, or none is kept any more")
    headers = _UNSTORED | {"X-Content-Type-Options": "nosniff", "Cross-Origin-Resource-Policy": "same-origin"}
    return Response(text, media_type="application/json", headers=headers)


@router.get("/approvals/{ask_id}/state")
async def read_state(request: Request, ask_id: str) -> JSONResponse:
    """State of the ask, and the number of votes, for everybody who has the link of its page."""
    asked, _, _ = await found_ask(request, ask_id)
    state = asked.state(provider_of(request).now_ms())
    return JSONResponse({"state": state.value, "votes": len(asked.votes)}, headers=_UNSTORED)


@router.post("/openings", status_code=201, openapi_extra=body_of(wire.OpeningBody))
async def open_tier_4(request: Request, call: Caller) -> JSONResponse:
    """A person lets a safety-critical act be asked for: 201, or 200 when the very same was made before."""
    text, provider = call.body(wire.OpeningBody).opening, provider_of(request)
    done = await provider.run(commands.OpenTier4(call.party.id, text, call.signed), actor=call.party.id)
    opening_id = stated(text, provider.rules.caps)["opening_id"]
    return JSONResponse({"opening_id": opening_id}, status_code=201 if done.events else 200, headers=_UNSTORED)


@router.get("/openings")
async def list_openings(request: Request, call: Bound) -> JSONResponse:
    """The openings that are not over, as they were signed, for people."""
    _only_people(call)
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        found = await view.approvals.openings(since_s=at_ms // 1_000)
    rows = [
        {
            "opening_id": opening.opening_id,
            "opener": opening.opener,
            "audience": opening.audience,
            "agent": opening.agent,
            "object": opening.object,
            "operation": opening.operation,
            "not_before": opening.not_before,
            "not_after": opening.not_after,
            "opening": opening.text,
        }
        for opening in found
        if not opening.over(at_ms)
    ]
    return JSONResponse(rows, headers=_UNSTORED)


@router.post("/openings/{opening_id}/withdraw", openapi_extra=body_of(wire.ReasonBody))
async def close_opening(request: Request, opening_id: str, call: Caller) -> dict[str, str]:
    """The opening is over."""
    reason = call.body(wire.ReasonBody).reason
    if not ID.fullmatch(opening_id):
        raise Problem(IdpCode.OPENING_UNKNOWN)
    await provider_of(request).run(commands.CloseOpening(call.party.id, opening_id, reason), actor=call.party.id)
    return {"opening_id": opening_id}


def _only_people(call: Call) -> None:
    if not isinstance(call.party, RegisteredPerson):
        raise Problem(IdpCode.NOT_PERMITTED, "people read asks")


async def found_ask(request: Request, ask_id: str) -> tuple[Asked, str, bytes]:
    """The ask with its votes, its text, and the key of the enforcement point that signed it."""
    async with provider_of(request).store.read() as view:
        asked = await view.approvals.asked(ask_id) if ID.fullmatch(ask_id) else None
        if asked is None:
            raise Problem(IdpCode.ASK_UNKNOWN)
        text, key = (await view.approvals.signed(frozenset({ask_id})))[ask_id]
    return asked, text, key


def _row(asked: Asked, shown: ask.Ask, state: AskState) -> dict[str, object]:
    return {
        "ask_id": shown.ask_id,
        "state": state.value,
        "audience": shown.audience,
        "agent": shown.agent,
        "sponsor": shown.sponsor,
        "object": shown.object,
        "operation": shown.operation,
        "tier": int(shown.tier),
        "index_milli": shown.index_milli,
        "reasons": list(shown.reasons),
        "perception": shown.perception,
        "approvers": shown.approvers,
        "votes": len(asked.votes),
        "asked_at": shown.asked_at,
        "expires_at": shown.expires_at,
        "trace_id": asked.ask.trace_id,
    }

"""Logging in with an operator key, the account's page, and logging out."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime
from typing import Annotated, Any
from urllib.parse import urlsplit

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from capabilities.keys.keys import thumbprint
from capabilities.values.errors import FaultCode
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.login.commands import OfferLogin
from ztpm_idp.domain.login.records import OFFER_MS
from ztpm_idp.domain.parties import RegisteredPerson
from ztpm_idp.login import session
from ztpm_idp.login.forms import browser_of, form_of
from ztpm_idp.login.pages import PageProblem, page
from ztpm_idp.login.passkey import PASSKEY, PASSKEY_S, PASSKEY_SCRIPT, ask_passkey, logged_in
from ztpm_idp.login.session import NO_STORE
from ztpm_idp.provider import wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import Call, authenticated, body_of, prefix_of, provider_of, since_of

router = APIRouter()
"""Pages and their forms are for browsers, and so not in the description of the API."""
Caller = Annotated[Call, Depends(authenticated)]


@router.post("/login/links", status_code=201, openapi_extra=body_of(wire.NothingBody))
async def offer_login(request: Request, call: Caller) -> dict[str, Any]:
    """A link that begins a session of the calling person in the browser that opens it: once, for two minutes."""
    call.body(wire.NothingBody)
    provider, secret = provider_of(request), secrets.token_urlsafe(32)
    at_ms = provider.now_ms()
    command = OfferLogin(call.party.id, thumbprint(call.key), session.digest(secret))
    await provider.run(command, actor=call.party.id)
    return {
        "url": f"{provider.settings.issuer}/login/links/{secret}",
        "expires_at": (at_ms + OFFER_MS) // 1_000,
    }


@router.get("/login", response_class=HTMLResponse, include_in_schema=False)
async def show_login(request: Request) -> Response:
    """The ways to log in; a browser whose person was authenticated recently enough goes on at once."""
    provider = provider_of(request)
    prefix, at_ms = prefix_of(provider), provider.now_ms()
    back_to = request.query_params.get("back_to", f"{prefix}/login/account")
    if not session.is_own_page(back_to, prefix):
        raise PageProblem(IdpCode.QUERY_MALFORMED, "back_to is no page of this provider")
    fresh_s = _seconds(request.query_params.get("fresh_s"))
    found = await session.signed_in(request)
    if found is not None and (fresh_s is None or found.fresh(fresh_s, at_ms=at_ms)):
        return RedirectResponse(back_to, status_code=303, headers=NO_STORE)
    browser = browser_of(request)
    asked = await ask_passkey(request)
    shown = page(
        "login.html",
        script=None if asked is None else PASSKEY_SCRIPT,
        passkey=asked,
        issuer=provider.settings.issuer,
        host=host_of(request),
        prefix=prefix,
        token=browser.form_token,
        who="" if found is None else found.person.id,
        providers=[
            {"name": each.name, "title": each.configured.stated.title, "host": urlsplit(each.origin).netloc}
            for each in request.app.state.login_providers.values()
        ],
        fresh_s="" if fresh_s is None else fresh_s,
    )
    browser.keep(shown)
    if asked is not None:
        session.set_cookie(shown, PASSKEY, asked.sealed, last_s=PASSKEY_S)
    session.remember_back(shown, back_to)
    return shown


@router.get("/login/links/{secret}", response_class=HTMLResponse, include_in_schema=False)
async def show_link(request: Request, secret: str) -> Response:
    """Asks whether to log in by this link.

    Opening it changes nothing, as mail filters and browsers fetch links ahead.
    """
    provider = provider_of(request)
    async with provider.store.read() as view:
        offer = await view.sessions.offer(session.digest(secret))
        person = None if offer is None else await view.party(offer.person)
    if offer is None or offer.over(provider.now_ms()) or not isinstance(person, RegisteredPerson):
        raise PageProblem(IdpCode.LOGIN_OVER, "ask for a new link: `ztpm login --browser`")
    found, browser = await session.signed_in(request), browser_of(request)
    who = "" if found is None else found.person.id
    shown = page(
        "link.html", person=person.id, name=person.name, host=host_of(request), token=browser.form_token, who=who
    )
    browser.keep(shown)
    return shown


@router.post("/login/links/{secret}", response_class=RedirectResponse, include_in_schema=False)
async def use_link(request: Request, secret: str) -> Response:
    """A session of the link's person begins in this browser; the link is spent."""
    await form_of(request)
    provider, digest = provider_of(request), session.digest(secret)
    async with provider.store.read() as view:
        offer = await view.sessions.offer(digest)
    if offer is None:
        raise PageProblem(IdpCode.LOGIN_OVER, "ask for a new link: `ztpm login --browser`")
    response = RedirectResponse(session.back_of(request), status_code=303, headers=NO_STORE)
    try:
        await session.begin(request, response, person=offer.person, offer=digest)
    except Problem as problem:
        raise PageProblem(problem.code, problem.detail) from None
    session.set_cookie(response, session.BACK, "", last_s=0)
    return response


@router.post("/login/passkey", response_class=RedirectResponse, include_in_schema=False)
async def use_passkey(request: Request) -> Response:
    """A session of the person begins whose passkey asserted the challenge of this browser's login page."""
    form = await form_of(request, "credential", "authenticator", "client", "signature")
    person, how, once = await logged_in(request, form)
    response = RedirectResponse(session.back_of(request), status_code=303, headers=NO_STORE)
    try:
        await session.begin(request, response, person=person, how=how, once=once)
    except Problem as problem:
        if problem.code is FaultCode.REPLAYED:
            raise PageProblem(IdpCode.LOGIN_OVER, "the passkey was used for this page before") from None
        raise PageProblem(problem.code, problem.detail) from None
    for spent in (session.BACK, PASSKEY):
        session.set_cookie(response, spent, "", last_s=0)
    return response


@router.get("/login/account", response_class=HTMLResponse, include_in_schema=False)
async def show_account(request: Request) -> Response:
    """The person who is logged in in this browser, with the way and the end of the session."""
    found = await session.signed_in(request)
    if found is None:
        return session.to_login(request, back_to=f"{prefix_of(provider_of(request))}/login/account", fresh_s=0)
    provider = provider_of(request)
    async with provider.store.read() as view:
        keys = await view.devices.session_keys_of(found.person.id)
    return page(
        "account.html",
        prefix=prefix_of(provider),
        token=browser_of(request).form_token,
        person=found.person.id,
        name=found.person.name,
        roles=sorted(role.value for role in found.person.roles),
        at=_time(found.at_ms),
        method=" ".join([found.how.method.value, *(f"({', '.join(found.amr)})" for _ in found.amr[:1])]),
        login=found.how.login,
        ends=_time(found.ends_ms),
        keys=[
            {"name": each.name, "thumbprint": thumbprint(each.key), "ends": _time(each.ends_ms)}
            for each in keys
            if not each.over(provider.now_ms())
        ],
    )


@router.post("/login/end", response_class=RedirectResponse, include_in_schema=False)
async def end_session(request: Request) -> Response:
    """The session of this browser is over."""
    await form_of(request)
    response = RedirectResponse(f"{prefix_of(provider_of(request))}/login", status_code=303, headers=NO_STORE)
    await session.end(request, response)
    return response


def host_of(request: Request) -> str:
    """Host and port of the issuer, for people to compare with their address bar."""
    return urlsplit(provider_of(request).settings.issuer).netloc


def _seconds(text: str | None) -> int | None:
    try:
        return None if text is None else since_of(text)
    except Problem as problem:
        raise PageProblem(problem.code, "fresh_s") from None


def _time(at_ms: int) -> str:
    return datetime.fromtimestamp(at_ms // 1_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")

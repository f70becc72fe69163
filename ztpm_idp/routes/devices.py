"""Command lines that log in: each asks with a key of its own, which a person confirms on a page."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any, Final

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.login.commands import AnswerDevice, AskDevice, EndSessionKey, EnterCode, PollDevice
from ztpm_idp.domain.login.devices import CARRIED
from ztpm_idp.domain.login.events import CodeWrong, DevicePolled
from ztpm_idp.domain.login.records import (
    DEVICE_INTERVAL_S,
    DEVICE_MS,
    ENROL_FRESH_S,
    SESSION_KEY_MS,
    Device,
    DeviceState,
)
from ztpm_idp.login import session
from ztpm_idp.login.forms import browser_of, form_of
from ztpm_idp.login.pages import PageProblem, page
from ztpm_idp.login.session import NO_STORE, SignedIn
from ztpm_idp.provider import wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import ProvenCall, body_of, by_any_key, prefix_of, provider_of
from ztpm_idp.routes.login import host_of
from ztpm_idp.routes.rated import address_of

if TYPE_CHECKING:
    from ztpm_idp.domain.login.commands import DeviceCommand
    from ztpm_idp.provider.done import Done

router = APIRouter()
AnyKey = Annotated[ProvenCall, Depends(by_any_key)]
LETTERS: Final = "BCDFGHJKLMNPQRSTVWXZ"
"""Letters of user codes: no vowels, so no words (RFC 8628 section 6.1)."""
CODE_LETTERS: Final = 8
"""Letters of a user code: 20^8, 34 bits, for ten minutes and ten guesses a session (RFC 8628 section 6.1)."""
ACTOR: Final = "device"
"""Actor of what a command line does before a person confirmed it; none of it is in the ledger."""


@router.post("/login/devices", status_code=201, openapi_extra=body_of(wire.DeviceBody))
async def ask(request: Request, call: AnyKey) -> dict[str, Any]:
    """A command line asks, with a proof by its own fresh key, for a person to confirm that key."""
    body, provider = call.body(wire.DeviceBody), provider_of(request)
    device_code, at_ms = secrets.token_urlsafe(32), provider.now_ms()
    user_code = "".join(secrets.choice(LETTERS) for _ in range(CODE_LETTERS))
    asked = Device(
        session.digest(device_code), user_code, call.key, body.name, _address(request), made_ms=at_ms, polled_ms=at_ms
    )
    await provider.run(AskDevice(asked), actor=ACTOR)
    return {
        "device_code": device_code,
        "user_code": shown_code(user_code),
        "verification_uri": f"{provider.settings.issuer}/login/device",
        "expires_in": DEVICE_MS // 1_000,
        "interval": DEVICE_INTERVAL_S,
    }


@router.post("/login/devices/poll", openapi_extra=body_of(wire.DevicePollBody))
async def poll(request: Request, call: AnyKey) -> dict[str, Any]:
    """The standing of a command line: it waits, and asks again after `interval` seconds, or its key signs."""
    provider = provider_of(request)
    digest = session.digest(call.body(wire.DevicePollBody).device_code)
    done = await provider.run(PollDevice(call.key, digest), actor=ACTOR)
    async with provider.store.read() as view:
        held = await view.devices.session_key(call.key)
    if held is None:
        (interval,) = (event.interval_s for event in done.events if isinstance(event, DevicePolled))
        return {"state": DeviceState.WAITING.value, "interval": interval}
    return {
        "state": DeviceState.CONFIRMED.value,
        "person": held.person,
        "roles": sorted(role.value for role in held.roles),
        "expires_at": held.ends_ms // 1_000,
        "authenticated_at": held.how.at_ms // 1_000,
        "method": held.how.method.value,
    }


@router.get("/login/device", response_class=HTMLResponse, include_in_schema=False)
async def show_device(request: Request) -> Response:
    """Asks a person who logged in recently for the code that the command line shows."""
    found = await _recent(request)
    return found if isinstance(found, Response) else _entry(request, found)


@router.post("/login/device", response_class=HTMLResponse, include_in_schema=False)
async def show_waiting(request: Request) -> Response:
    """The command line that waits under the code that was entered, for the person to look at."""
    form, found = await form_of(request, "code"), await _recent(request)
    if isinstance(found, Response):
        return found
    code = plain_code(form["code"])
    done = await _run(request, EnterCode(found.person.id, found.session_id, code), found)
    provider = provider_of(request)
    async with provider.store.read() as view:
        waiting = next((each for each in await view.devices.devices() if each.user_code == code), None)
    if waiting is None or any(isinstance(event, CodeWrong) for event in done.events):
        return _entry(request, found, wrong=True)
    return page(
        "confirm.html",
        prefix=prefix_of(provider),
        token=browser_of(request).form_token,
        who=found.person.id,
        code=shown_code(code),
        name=waiting.name,
        address=waiting.address,
        asked=_time(waiting.made_ms),
        thumbprint=thumbprint(waiting.key),
        roles=sorted(role.value for role in found.person.roles & CARRIED),
        ends=_time(found.at_ms + SESSION_KEY_MS),
    )


@router.post("/login/device/answer", response_class=HTMLResponse, include_in_schema=False)
async def answer_device(request: Request) -> Response:
    """The command line is confirmed, and its key signs for the person from now on; or it is declined."""
    form, found = await form_of(request, "code", "answer"), await _recent(request)
    if isinstance(found, Response):
        return found
    if form["answer"] not in {"confirm", "decline"}:
        raise PageProblem(IdpCode.FORM_MALFORMED, "answer")
    confirmed = form["answer"] == "confirm"
    command = AnswerDevice(found.person.id, found.session_id, plain_code(form["code"]), confirmed)
    done = await _run(request, command, found)
    if any(isinstance(event, CodeWrong) for event in done.events):
        return _entry(request, found, wrong=True)
    return page(
        "done.html",
        prefix=prefix_of(provider_of(request)),
        title="Confirmed" if confirmed else "Declined",
        text="Go back to your terminal." if confirmed else "The command line got nothing.",
    )


@router.post("/login/keys/end", response_class=RedirectResponse, include_in_schema=False)
async def end_key(request: Request) -> Response:
    """A command line's key signs for this person no more."""
    form, found = await form_of(request, "thumbprint"), await session.signed_in(request)
    if found is None:
        raise PageProblem(IdpCode.NOT_LOGGED_IN)
    await _run(request, EndSessionKey(found.person.id, form["thumbprint"]), found)
    return RedirectResponse(f"{prefix_of(provider_of(request))}/login/account", status_code=303, headers=NO_STORE)


def shown_code(user_code: str) -> str:
    """The code as people read it: two groups."""
    return f"{user_code[:4]}-{user_code[4:]}"


def plain_code(entered: str) -> str:
    """The code that a person entered, in either case, with any signs between."""
    return "".join(letter for letter in entered.upper() if letter in LETTERS)


async def _recent(request: Request) -> SignedIn | Response:
    provider = provider_of(request)
    found = await session.signed_in(request)
    if found is not None and found.fresh(ENROL_FRESH_S, at_ms=provider.now_ms()):
        return found
    return session.to_login(request, back_to=f"{prefix_of(provider)}/login/device", fresh_s=ENROL_FRESH_S)


def _entry(request: Request, found: SignedIn, *, wrong: bool = False) -> HTMLResponse:
    return page(
        "device.html",
        status=400 if wrong else 200,
        prefix=prefix_of(provider_of(request)),
        token=browser_of(request).form_token,
        who=found.person.id,
        host=host_of(request),
        wrong=wrong,
    )


async def _run(request: Request, command: DeviceCommand, found: SignedIn) -> Done:
    try:
        return await provider_of(request).run(command, actor=found.person.id)
    except Problem as problem:
        raise PageProblem(problem.code, problem.detail) from None


def _address(request: Request) -> str:
    return (address_of(request) or "unknown")[:64]


def _time(at_ms: int) -> str:
    return datetime.fromtimestamp(at_ms // 1_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")

"""Devices that people have told of questions and stopped robots, with no page open: by Web Push."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, RedirectResponse, Response

from capabilities.keys.keys import unb64u
from capabilities.values.errors import BadKeyError
from ztpm_idp.domain.asking.subscriptions import OF_A_PERSON, OF_ALL, Subscription
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login import session
from ztpm_idp.login.forms import form_of
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.login.session import NO_STORE
from ztpm_idp.provider.problems import Problem
from ztpm_idp.push.encryption import SECRET_BYTES, public_point
from ztpm_idp.push.pushing import BESIDE
from ztpm_idp.routes.caller import prefix_of, provider_of
from ztpm_idp.web_push_settings import place_of

if TYPE_CHECKING:
    from ztpm_idp.login.session import SignedIn

router = APIRouter()
"""For browsers, and so not in the description of the API."""


@router.post("/approvals/page/devices", status_code=201, include_in_schema=False)
async def add_device(request: Request) -> JSONResponse:
    """The device of this browser is told from now on, for as long as the session could last.

    Raises:
        Problem: `NOT_LOGGED_IN`, `PATH_UNKNOWN` (no Web Push here), `DEVICE_REFUSED`, `DEVICES_SPENT`.
        PageProblem: as `form_of`.
    """
    form = await form_of(request, "endpoint", "p256dh", "auth")
    found, provider = await session.signed_in(request), provider_of(request)
    if found is None:
        raise Problem(IdpCode.NOT_LOGGED_IN)
    at_ms = provider.now_ms()
    made = _subscription(request, found, form, at_ms=at_ms)
    async with provider.store.write(BESIDE) as transaction:
        await transaction.pushes.turn()  # one device after the other, so that no two are the last that may be added
        others = [each for each in await transaction.subscriptions.living(at_ms=at_ms) if each.id != made.id]
        if len(others) >= OF_ALL or sum(each.person == made.person for each in others) >= OF_A_PERSON:
            raise Problem(IdpCode.DEVICES_SPENT, f"at most {OF_A_PERSON} of one person, and {OF_ALL} of all")
        await transaction.subscriptions.keep(made)
    return JSONResponse({"device": made.id}, status_code=201, headers=NO_STORE)


@router.post("/approvals/page/devices/end", include_in_schema=False)
async def end_device(request: Request) -> Response:
    """A device of the person's own is told no more; back to the page.

    Raises:
        PageProblem: `NOT_LOGGED_IN`, and as `form_of`.
    """
    form = await form_of(request, "device")
    found, provider = await session.signed_in(request), provider_of(request)
    if found is None:
        raise PageProblem(IdpCode.NOT_LOGGED_IN)
    async with provider.store.read() as view:
        living = await view.subscriptions.living(at_ms=provider.now_ms())
    if (form["device"], found.person.id) in {(each.id, each.person) for each in living}:
        async with provider.store.write(BESIDE) as transaction:
            await transaction.subscriptions.end(form["device"])
    return RedirectResponse(f"{prefix_of(provider)}/approvals/page", status_code=303, headers=NO_STORE)


def _subscription(request: Request, found: SignedIn, form: dict[str, str], *, at_ms: int) -> Subscription:
    """The subscription that a form states.

    Raises:
        Problem: `PATH_UNKNOWN`, `DEVICE_REFUSED`.
    """
    stated = provider_of(request).settings.web_push
    if stated is None:
        raise Problem(IdpCode.PATH_UNKNOWN, "no device is told: the settings have no web_push")
    if place_of(form["endpoint"], stated) is None:
        raise Problem(IdpCode.DEVICE_REFUSED, "its push service is none of web_push.services in the settings")
    try:
        key, secret = unb64u(form["p256dh"]), unb64u(form["auth"])
        public_point(key)
    except (BadKeyError, ValueError):
        raise Problem(IdpCode.DEVICE_REFUSED, "p256dh is an uncompressed point of P-256, in base64url") from None
    if len(secret) != SECRET_BYTES:
        raise Problem(IdpCode.DEVICE_REFUSED, f"auth is {SECRET_BYTES} bytes, in base64url")
    return Subscription(found.person.id, found.session_id, form["endpoint"], key, secret, at_ms)

"""Open questions and stopped robots on a page for people who are logged in; it tells of new ones."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from capabilities.keys.keys import b64u
from capabilities.statements.people import ask as ask_statement
from capabilities.values.characters import shown
from ztpm_idp.domain.asking.asks import AskState
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login import session
from ztpm_idp.login.forms import browser_of
from ztpm_idp.login.session import NO_STORE
from ztpm_idp.provider import ask_page
from ztpm_idp.provider.ask_page import TEXTS, TIERS, time_of
from ztpm_idp.provider.problems import Problem
from ztpm_idp.push.encryption import raw_point, signing_key
from ztpm_idp.push.pushing import LATCHES
from ztpm_idp.routes.caller import prefix_of, provider_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from ztpm_idp.domain.asking.latch_acts import LatchRecord
    from ztpm_idp.provider.provider import Provider

router = APIRouter()
"""For browsers, and so not in the description of the API."""
EVERY_S: Final = 5
"""Ours: seconds between two looks of an open page."""
OLD_S: Final = 12
"""Ours: seconds without a word after which the page says that it is old: two looks, and a little."""
FRESH_S: Final = 43_200
"""Greatest age of the login: a session lives no longer anyway."""
_SAID: Final = json.dumps(TEXTS["open_asks_script"])


@router.get("/approvals/page", response_class=HTMLResponse, include_in_schema=False)
async def show_open_asks(request: Request) -> Response:
    """The open questions, oldest first, with the switch for notifications."""
    found, provider = await session.signed_in(request), provider_of(request)
    prefix = prefix_of(provider)
    if found is None:
        return session.to_login(request, back_to=f"{prefix}/approvals/page", fresh_s=FRESH_S)
    issuer, devices = provider.settings.issuer, await _devices(provider, found.person.id)
    page = ask_page.PAGES.get_template("open_asks.html").render(
        style=ask_page.STYLE,
        look=ask_page.look_of(issuer),
        script=ask_page.list_script_of(issuer),
        said=_SAID,
        prefix=prefix,
        person=found.person.id,
        every_s=EVERY_S,
        old_s=OLD_S,
        reload_s=ask_page.RELOAD_S,
        devices=devices,
        token=browser_of(request).form_token,
        worker=ask_page.worker_of(issuer),
        **await _waiting(provider),
    )
    return HTMLResponse(page, headers=NO_STORE | ask_page.list_headers(issuer, devices=devices is not None))


@router.get("/approvals/page/open", include_in_schema=False)
async def list_open_asks(request: Request) -> JSONResponse:
    """The open questions for the script of that page; asking so does not prolong the session.

    Raises:
        Problem: `NOT_LOGGED_IN`.
    """
    if await session.signed_in(request, prolongs=False) is None:
        raise Problem(IdpCode.NOT_LOGGED_IN)
    provider = provider_of(request)
    return JSONResponse(await _waiting(provider), headers=NO_STORE)


async def _devices(provider: Provider, person: str) -> dict[str, object] | None:
    """The provider's key for push services, and the person's devices; None where no device is told."""
    if provider.settings.web_push is None:
        return None
    async with provider.store.read() as view:
        secret = await view.sessions.secret()
        living = await view.subscriptions.living(at_ms=provider.now_ms())
    mine = [
        {"id": each.id, "service": each.service, "since": time_of(each.made_ms // 1_000)}
        for each in living
        if each.person == person
    ]
    return {"key": b64u(raw_point(signing_key(secret).public_key())), "mine": mine}


async def _waiting(provider: Provider) -> dict[str, object]:
    """All that waits for people, as of now: questions, the oldest first, and robots."""
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        asks = await view.approvals.not_long_over(since_s=at_ms // 1_000)
        ids = [each.ask.ask_id for each in asks if each.state(at_ms) is AskState.OPEN]
        signed = await view.approvals.signed(frozenset(ids))
        latches = await view.latches.not_long_over(since_ms=at_ms, most=LATCHES)
    return {
        "shown_at": time_of(at_ms // 1_000),
        "open": _open(provider, ids, signed),
        "latched": [_latched(provider, each) for each in latches if not each.released],
    }


def _open(provider: Provider, ids: Iterable[str], signed: Mapping[str, tuple[str, bytes]]) -> list[dict[str, object]]:
    """Rows of the open questions."""
    rows = list[dict[str, object]]()
    for ask_id in ids:
        text, key = signed[ask_id]
        ask = ask_statement.open(text, {key}, provider.rules.caps)
        words = TEXTS["open_asks"]["asks_for"].format(
            agent=ask.agent,
            operation=ask.operation,
            object=ask.object,
            tier=TIERS[ask.tier],
            until=time_of(ask.expires_at),
        )
        rows.append(
            {
                "ask_id": ask_id,
                "url": f"{provider.settings.issuer}/approvals/{ask_id}/page",
                "tier": int(ask.tier),
                "words": shown(words),
            }
        )
    return rows


def _latched(provider: Provider, latch: LatchRecord) -> dict[str, object]:
    """Row of a robot that waits."""
    words = TEXTS["open_asks"]["has_stopped"].format(robot=latch.robot, pep=latch.pep, since=time_of(latch.at))
    url = f"{provider.settings.issuer}/latches/{latch.latch_id}/page"
    return {"latch_id": latch.latch_id, "url": url, "words": shown(words)}

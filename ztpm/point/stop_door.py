"""The gateway's own address for a stop, which needs no ticket, no token and no page ([LIV-7]).

    request    POST, body: {"stop":true}, or {"stop":true,"word":"..."} with what a person signed ([STM-26])
    answer     200 {"stopped":true,"by":"gateway","lease","person","fault","latch"}

The stop begins before a byte of the body is read; a body that says anything else is a stop, too.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse

from capabilities.statements.people.stop import STOP_BYTES
from capabilities.values import strict_json
from pep.base import caller_place
from ztpm.base.stop_call import GATEWAY

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

    from ztpm.point.open_stop import OpenStop

BODY_BYTES: Final = STOP_BYTES + 64
"""Longest body that is read: a word and what is around it."""
BODY_S: Final = 1.0
"""Time for a body; one of a person's command comes with its request."""
UNREADABLE: Final = "?"
"""Word of a body that cannot be read: it is no statement, and refused as such."""
_UNSTORED: Final = {"Cache-Control": "no-store"}


class StopDoor:
    """ASGI app of that URL.

    Args:
        stop: of the arm.
    """

    def __init__(self, stop: OpenStop) -> None:
        self._stop = stop

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        await (await self._answer(Request(scope, receive)))(scope, receive, send)

    async def _answer(self, request: Request) -> JSONResponse:
        caller_place.stopping(request.scope)
        if request.method != "POST":
            return JSONResponse({"code": "METHOD_NOT_ALLOWED"}, 405, {**_UNSTORED, "Allow": "POST"})
        # A browser names the page that asks, and no page of ours asks here.
        if "origin" in request.headers:
            return JSONResponse({"code": "WRONG_ORIGIN"}, 403, _UNSTORED)
        heard, lease, latch = await self._stop.by_word(_word(request))
        told = {
            "stopped": True,
            "by": GATEWAY,
            "lease": lease,
            "person": heard.person,
            "fault": heard.fault,
            # strangers are told no more of a latch than that there is one
            "latch": latch if heard.person else {"latched": latch["latched"]},
        }
        return JSONResponse(told, 200, _UNSTORED)


async def _word(request: Request) -> str:
    """The word in the body; empty where it has none."""
    body = b""
    try:
        async with asyncio.timeout(BODY_S):
            async for chunk in request.stream():
                body += chunk
                if len(body) > BODY_BYTES:
                    return UNREADABLE
    except (TimeoutError, ClientDisconnect):
        return UNREADABLE
    if not body:
        return ""
    try:
        said = strict_json.read(body, limit_bytes=BODY_BYTES, limit_depth=1)
    except strict_json.JsonError:
        return UNREADABLE
    if not isinstance(said, dict) or said.get("stop") is not True or not said.keys() <= {"stop", "word"}:
        return UNREADABLE
    word = said.get("word", "")
    return word if isinstance(word, str) else UNREADABLE

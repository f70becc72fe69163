"""Enforcement points confirm how far they follow the feed, and people who revoke are shown it.

After a restore they tell what they know to be revoked; an administrator resumes, and vouches for agents.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final

from fastapi import APIRouter, Depends, Request
from sse_starlette import EventSourceResponse, ServerSentEvent

from ztpm_idp.domain import commands
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.parties import RegisteredPerson
from ztpm_idp.provider import confirmations, wire
from ztpm_idp.provider.body_json import BODY_BYTES
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    Call,
    authenticated,
    authenticated_within,
    body_of,
    parsed,
    provider_of,
    query_of,
    read_body,
    since_of,
)
from ztpm_idp.routes.described import query

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from ztpm_idp.provider.confirmations import Confirmations

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Point = Annotated[Call, Depends(authenticated_within(BODY_BYTES))]
STREAM_S: Final = 600.0
"""Longest life of one stream of events: its client connects again, perhaps to another worker."""
PING_S: Final = 15
"""Seconds between two comments: half of the silence after which common proxies drop a connection."""
SEND_S: Final = 10.0
"""Longest wait for a client that does not read."""
RETRY_MS: Final = 1_000
"""Pause of a browser before it connects again."""
MARK_BYTES: Final = 4_096
"""Largest body with a mark that has no entries."""


def confirmations_of(request: Request) -> Confirmations:
    """The marks that this application waits to write."""
    found: Confirmations = request.app.state.confirmations
    return found


@router.get("/revocations/events", response_class=EventSourceResponse, openapi_extra=query("since"))
async def events(request: Request) -> EventSourceResponse:
    """Server-sent events: `epoch` at each revocation, for who would wait for the next one again and again.

    An event is an unsigned hint: the signed index counts. `Last-Event-ID` takes the place of `since` when a connection
    is made anew; comments keep it open through proxies.
    """
    (since,) = query_of(request, "since")
    known = since_of(request.headers.get("last-event-id", since))
    epochs = provider_of(request).epochs
    epochs.check_place()

    async def told() -> AsyncIterator[ServerSentEvent]:
        yield ServerSentEvent(retry=RETRY_MS, comment="revocations")
        async for epoch in epochs.growing(known, longest_s=STREAM_S):
            yield ServerSentEvent(event="epoch", id=str(epoch), data=f'{{"epoch":{epoch}}}')

    return EventSourceResponse(told(), ping=PING_S, send_timeout=SEND_S)


@router.post("/revocations/marks", openapi_extra=body_of(wire.MarkBody))
async def confirm(request: Request) -> dict[str, bool]:
    """An enforcement point's mark without entries: it is signed itself, so no proof goes with it."""
    text = parsed(wire.MarkBody, await read_body(request, body_bytes=MARK_BYTES)).mark
    await confirmations.take_mark(provider_of(request), confirmations_of(request), text)
    return {"taken": True}


@router.get("/revocations/points")
async def points(request: Request, call: Annotated[Call, Depends(authenticated)]) -> dict[str, Any]:
    """Every active enforcement point with the highest mark that it confirmed, for people."""
    if not isinstance(call.party, RegisteredPerson):
        raise Problem(IdpCode.NOT_PERMITTED)
    provider = provider_of(request)
    async with provider.store.read() as view:
        counters, found = await view.counters(), await view.points.every()
    now_ms = provider.now_ms()
    return {
        "line": counters.revocation_line,
        "epoch": counters.epoch,
        "now_ms": now_ms,
        "points": [
            {
                "pep": point.pep,
                "audiences": list(point.audiences),
                "line": point.line,
                "epoch": point.epoch,
                "confirmed_ms": point.confirmed_ms,
                "heard_ms": point.heard_ms,
                "connected": now_ms - point.heard_ms <= confirmations.CONNECTED_MS,
            }
            for point in found
        ],
    }


@router.post("/restoring/marks", openapi_extra=body_of(wire.MarkBody))
async def take_mark(request: Request, call: Point) -> dict[str, bool]:
    """An enforcement point's mark, or a part of it, is taken; offering it again changes nothing."""
    text = call.body(wire.MarkBody).mark
    await provider_of(request).run(commands.TakeMark(call.party.id, text), actor=call.party.id)
    return {"taken": True}


@router.post("/restoring/resume", openapi_extra=body_of(wire.ResumeBody))
async def resume(request: Request, call: Caller) -> dict[str, bool]:
    """An administrator ends the restore, and names exactly the enforcement points that were not heard."""
    unheard = frozenset(call.body(wire.ResumeBody).unheard)
    await provider_of(request).run(commands.ResumeStore(call.party.id, unheard, call.signed), actor=call.party.id)
    return {"resumed": True}


@router.post("/agents/{id_}/vouch", openapi_extra=body_of(wire.ReasonBody))
async def vouch(request: Request, id_: str, call: Caller) -> dict[str, str]:
    """An administrator vouches for an agent that is held since a restore."""
    reason = call.body(wire.ReasonBody).reason
    await provider_of(request).run(commands.VouchAgent(call.party.id, id_, reason), actor=call.party.id)
    return {"id": id_}

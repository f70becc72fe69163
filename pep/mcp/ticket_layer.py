"""The gateway's end of a forwarded call: admits only requests of an enrolled tool server, byte for byte.

It stands before the guarded app, at a path of its own. A ticket lends nothing: the app behind verifies the caller's
token and proof itself, for the same audience, method and body. A stop needs no ticket, as it needs no token.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from capabilities.statements import ticket
from capabilities.statements.ticket import RequestDigests, Ticket
from capabilities.values.errors import Fault, FaultCode
from pep.base import caller_place
from pep.base.errors import ReplayStoreError
from pep.mcp.body_screen import BODY_BYTES, Unfit
from pep.mcp.http_request import (
    HttpRequest,
    Refusals,
    answer,
    digest,
    headers_of,
    read_body,
    replayed,
    rpc_of,
    short,
    token_in,
)
from pep.mcp.mapping import stops
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from starlette.types import ASGIApp, Receive, Scope, Send

    from capabilities.values.caps import Caps
    from pep.base.operation_row import Operation
    from pep.base.ports import Clock, ReplayStore, RevocationFeed
    from pep.request.edge import Edge

TICKET: Final = "ztpm-ticket"
"""Header of a ticket."""
_CALLER_IS_TOLD: Final = {
    FaultCode.EXPIRED: Reason.VERDICT_EXPIRED,
    FaultCode.NOT_YET_VALID: Reason.VERDICT_EXPIRED,
    FaultCode.WRONG_AUDIENCE: Reason.NOT_WHAT_WAS_DECIDED,
    FaultCode.PROOF_NOT_FOR_THIS_REQUEST: Reason.NOT_WHAT_WAS_DECIDED,
}
"""Reason for the caller where a ticket has a fault, which concerns neither its token nor its proof."""


class TicketLayer:
    """ASGI layer around a guarded app that only tool servers reach.

    Args:
        app: the guarded app.
        edge: takes records; the gate.
        tools: their operations, by name: stops need no ticket.
        peps: raw public key of each enrolled tool server, by its id, as of now.
        feed: the revocation feed.
        replay: ids of tickets; may be the store of proofs.
        audience: canonical URL of the cell; its path is where the app answers.
        url: canonical URL at which this layer answers.
        clock: both clocks.
        caps: bounds.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        edge: Edge,
        tools: Mapping[str, Operation],
        peps: Callable[[], Mapping[str, bytes]],
        feed: RevocationFeed,
        replay: ReplayStore,
        audience: str,
        url: str,
        clock: Clock,
        caps: Caps,
    ) -> None:
        self._app = app
        self._refusals = Refusals(edge, clock)
        self._tools = tools
        self._peps = peps
        self._feed = feed
        self._replay = replay
        self._audience = audience
        self._url = url
        self._clock = clock
        self._caps = caps
        self._path = urlsplit(url).path
        self._inner_path = urlsplit(audience).path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await self._http(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": 1008})

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] != self._path or scope["query_string"]:
            await answer(send, 404, b"")
            return
        body = await read_body(receive)
        if body is None:
            return
        headers = headers_of(scope)
        found = self._ticket(headers, body)
        if isinstance(found, Ticket):
            caller_place.proven(scope, f"pep {found.pep}")
        if isinstance(found, Ticket) or self._stops(scope["method"], headers, body):
            await self._app(self._inside(scope), replayed(body, receive), send)
            return
        reason, where = found
        where = {"method": scope["method"], "path": self._path, "body": digest(body), **where}
        status = 400 if reason in {Reason.BODY_MALFORMED, Reason.BODY_TOO_LARGE} else 403
        await self._refusals.refuse(send, status, reason, credentials=None, where=where)

    def _ticket(self, headers: Mapping[str, str | None], body: bytes) -> Ticket | tuple[Reason, dict[str, object]]:
        """Ticket of exactly this request, used up now; or its reason for the caller, and its fault for the record."""
        if len(body) > BODY_BYTES:
            return Reason.BODY_TOO_LARGE, {}
        # What a request says twice, two readers may read differently.
        twice = next((name for name, value in headers.items() if value is None), None)
        if twice is not None:
            return Reason.BODY_MALFORMED, {"detail": f"the header {short(twice)} came more than once"}
        text = headers.get(TICKET)
        if text is None:
            return Reason.TICKET_MISSING, {}
        peps = self._peps()
        found = ticket.verify(
            text,
            RequestDigests.of(token=token_in(headers), proof=headers.get("dpop"), body=body),
            peps=peps,
            view=self._feed.view(),
            audience=self._audience,
            url=self._url,
            at=self._clock.wall_s(),
            caps=self._caps,
        )
        if isinstance(found, Ticket):
            found = self._once(found, peps[found.pep]) or found
        if isinstance(found, Ticket):
            return found
        reason = _CALLER_IS_TOLD.get(found.code) or Reason(found.code)
        return reason, {"clause": found.clause, "fault": str(found.code), "detail": found.detail}

    def _once(self, found: Ticket, key: bytes) -> Fault | None:
        # [TKT-7] single use
        expires_ms = self._clock.monotonic_ms() + ticket.retention_ms(self._caps)
        try:
            first = self._replay.first_use(found.id, key=key, expires_ms=expires_ms)
        except ReplayStoreError as error:
            return Fault(FaultCode.REPLAYED, "TKT-7", str(error.code))  # a replay cannot be excluded
        return None if first else Fault(FaultCode.REPLAYED, "TKT-7", "the ticket was used before")

    def _stops(self, method: str, headers: Mapping[str, str | None], body: bytes) -> bool:
        """True where the request only stops, which any caller may."""
        rpc = rpc_of(method, body)
        return not isinstance(rpc, Unfit) and stops(self._tools, HttpRequest(method, headers, body, rpc).tool)

    def _inside(self, scope: Scope) -> Scope:
        """The same request at the address of the audience, with its ticket spent."""
        headers = [(name, value) for name, value in scope["headers"] if name.lower() != TICKET.encode()]
        return {**scope, "path": self._inner_path, "raw_path": self._inner_path.encode(), "headers": headers}

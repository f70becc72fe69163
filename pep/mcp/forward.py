"""Tool server without tools: each request goes to the gateway of the robot, whole.

It stands behind `DPoPLayer`, which has verified token and proof. Each request goes out with a ticket of its own, issued
at the last moment; a call of a tool is on record before. The answer comes back as it comes, however long a motion
lasts; a caller that goes away ends the call at the gateway.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import socket
from typing import TYPE_CHECKING, Any, Final, cast

import httpx2

from capabilities import tracing
from capabilities.statements import ticket
from capabilities.statements.ticket import RequestDigests
from capabilities.values import trace_context
from capabilities.values.chain import Chain
from pep.base.errors import JournalError
from pep.base.traced import traced
from pep.mcp.http_request import CREDENTIALS, HTTP_REQUEST, HttpRequest, Refusals, digest, short, token_in
from pep.mcp.mapping import stops
from pep.mcp.ticket_layer import TICKET
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from starlette.types import Receive, Scope, Send

    from capabilities.keys.keys import PrivateKey
    from pep.base.operation_row import Operation
    from pep.base.ports import Clock
    from pep.request.authority import Credentials
    from pep.request.edge import Edge

PASSED_ON: Final = frozenset({"authorization", "dpop", "content-type", "accept", "host", "origin", "last-event-id"})
"""Headers of a request that go on, besides those of MCP. Host and origin are judged at the gateway."""
MCP_HEADERS: Final = "mcp-"
HOP_BY_HOP: Final = frozenset(
    {
        "connection", "keep-alive", "proxy-authenticate", "proxy-authorization", "te", "trailer", "trailers",
        "transfer-encoding", "upgrade",
    }
)  # fmt: skip
"""Headers of one connection only (RFC 9110 section 7.6.1)."""
OWN: Final = frozenset({"date", "server"})
"""Headers that each server sets itself."""
CONNECT_S: Final = 2.0
"""Longest wait for a connection; within a cell it takes milliseconds."""
ANSWER_S: Final = 25.0
"""Longest wait for the beginning of an answer. The gateway begins after 15 s at the latest in every case."""
SILENCE_S: Final = 45.0
"""Longest silence within an answer: three of the signs of life that come every 15 s."""
IDLE_S: Final = 2.0
"""Time for which a connection waits for the next request: less than the gateway's 5 s before it closes."""
PROBE_S: Final = 5
"""Period of probes over a silent connection; a third of the time for which it may stay unanswered."""


def client() -> httpx2.AsyncClient:
    """Client of the gateway, without a bound on a whole request; it notices a peer that is gone."""
    # Linux's names for the interval and the number of probes; elsewhere the system's own are what there is.
    probes = [
        (socket.IPPROTO_TCP, getattr(socket, name), value)
        for name, value in (("TCP_KEEPIDLE", PROBE_S), ("TCP_KEEPINTVL", PROBE_S), ("TCP_KEEPCNT", 2))
        if hasattr(socket, name)
    ]
    return httpx2.AsyncClient(
        transport=httpx2.AsyncHTTPTransport(
            limits=httpx2.Limits(max_connections=None, max_keepalive_connections=8, keepalive_expiry=IDLE_S),
            socket_options=[(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1), *probes],
        ),
        timeout=httpx2.Timeout(CONNECT_S, read=SILENCE_S),
        follow_redirects=False,
    )


class Forward:
    """ASGI app that passes requests on.

    Args:
        http: client of the gateway, as `client` makes it.
        edge: takes records.
        tools: their operations, by name: a stop waits for no record.
        audience: canonical URL of the cell.
        url: canonical URL of the gateway's endpoint.
        pep_id: registered id of this enforcement point.
        key: of it.
        clock: both clocks.
        random: so many random bytes, in hex.
    """

    def __init__(
        self,
        http: httpx2.AsyncClient,
        *,
        edge: Edge,
        tools: Mapping[str, Operation],
        audience: str,
        url: str,
        pep_id: str,
        key: PrivateKey,
        clock: Clock,
        random: Callable[[int], str] = secrets.token_hex,
    ) -> None:
        self._http = http
        self._edge = edge
        self._refusals = Refusals(edge, clock)
        self._tools = tools
        self._audience = audience
        self._url = url
        self._pep_id = pep_id
        self._key = key
        self._clock = clock
        self._random = random

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection; of a request that came through `DPoPLayer`."""
        if scope["type"] == "lifespan":
            await _lives(receive, send)
            return
        http_request, credentials = cast("HttpRequest", scope[HTTP_REQUEST]), cast("Credentials", scope[CREDENTIALS])
        if stops(self._tools, http_request.tool):  # also when the caller does not wait for the answer
            await self._pass_on(http_request, credentials, send)
            return
        passing = asyncio.create_task(self._pass_on(http_request, credentials, send))
        gone = asyncio.create_task(_gone(receive))
        try:
            await asyncio.wait({passing, gone}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            # A caller who goes away has its call ended, here and by the closed connection at the gateway.
            for task in (passing, gone):
                task.cancel()
            ended = await asyncio.gather(passing, gone, return_exceptions=True)
        for end in ended:
            if isinstance(end, Exception):
                raise end

    async def _pass_on(self, http_request: HttpRequest, credentials: Credentials, send: Send) -> None:
        """Sends the request to the gateway and its answer back, or refuses it."""
        stopping = stops(self._tools, http_request.tool)  # it waits for no record, and for no caller who may have gone
        headers = {n: v for n, v in http_request.headers.items() if n in PASSED_ON or n.startswith(MCP_HEADERS)}
        where: dict[str, object] = {
            "method": http_request.method,
            "tool": short(http_request.tool),
            "body": digest(http_request.body),
        }
        if None in headers.values() and not stopping:
            await self._refusals.refuse(send, 400, Reason.BODY_MALFORMED, credentials=credentials, where=where)
            return
        # Of a stop's headers, repeated ones are not passed on.
        once = {name: value for name, value in headers.items() if value is not None}
        name = self._random(16)
        record = traced(self._record(name, http_request, credentials))
        if http_request.calls and not stopping:
            try:
                await self._edge.record("ticket", record)
            except JournalError:
                await self._refusals.refuse(send, 503, Reason.RECORD_FAILED, credentials=credentials, where=where)
                return
        try:
            with tracing.step(trace_context.FORWARD, {}):
                response = await self._asked(name, http_request, once, again=stopping)
        except (httpx2.HTTPError, TimeoutError) as error:
            where |= {"ticket": name, "error": type(error).__name__}
            await self._refusals.refuse(send, 503, Reason.GATEWAY_UNREACHABLE, credentials=credentials, where=where)
        else:
            await self._come_back(response, send, name)
        if stopping:  # recorded when it has been passed on, and passed on also without
            with contextlib.suppress(JournalError):
                await self._edge.record("ticket", record)

    def _record(self, name: str, http_request: HttpRequest, credentials: Credentials) -> dict[str, object]:
        chain = credentials.chain
        leaf = chain.leaf if isinstance(chain, Chain) and credentials.fault is None else None
        return {
            "ticket": name,
            "proof": credentials.proof_name,
            "tool": short(http_request.tool),
            "agent": None if leaf is None else leaf.agent,
            "hop": None if leaf is None else leaf.hop_id,
            "gateway": self._url,
        }

    async def _asked(
        self, name: str, http_request: HttpRequest, headers: Mapping[str, str], *, again: bool
    ) -> httpx2.Response:
        """Beginning of the gateway's answer.

        Args:
            name: of the ticket.
            http_request: the request.
            headers: that go with it.
            again: it may be sent twice: stopping twice is stopping.

        Raises:
            httpx2.HTTPError, TimeoutError: there is none.
        """
        try:
            return await self._sent(name, http_request, headers)
        except httpx2.TransportError:
            if not again:
                raise
        return await self._sent(name, http_request, headers)

    async def _sent(self, name: str, http_request: HttpRequest, headers: Mapping[str, str]) -> httpx2.Response:
        carried = RequestDigests.of(
            token=token_in(http_request.headers), proof=http_request.headers.get("dpop"), body=http_request.body
        )
        issued = ticket.issue(
            carried,
            id=name,
            pep=self._pep_id,
            audience=self._audience,
            url=self._url,
            key=self._key,
            at=self._clock.wall_s(),
        )
        # Made by hand, so that no header and no cookie is added to the caller's own.
        request = httpx2.Request(
            http_request.method,
            self._url,
            headers={**headers, **tracing.carried(), TICKET: issued},
            content=http_request.body,
        )
        async with asyncio.timeout(ANSWER_S):
            return await self._http.send(request, stream=True)

    async def _come_back(self, response: httpx2.Response, send: Send, name: str) -> None:
        """Passes the answer back as it came; one that broke off stays without its end."""
        try:
            await send(
                {"type": "http.response.start", "status": response.status_code, "headers": _passed_back(response)}
            )
            async for chunk in response.aiter_raw():
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
        except httpx2.HTTPError as error:
            with contextlib.suppress(JournalError):
                body: dict[str, Any] = {"what": "gateway", "ticket": name, "fault": type(error).__name__}
                await self._edge.record("incident", body)
        finally:
            await response.aclose()


def _passed_back(response: httpx2.Response) -> list[tuple[bytes, bytes]]:
    named = {name.strip().lower() for name in response.headers.get("connection", "").split(",")}
    kept = ((name.lower(), value) for name, value in response.headers.raw)
    return [(name, value) for name, value in kept if name.decode("latin-1") not in HOP_BY_HOP | OWN | named]


async def _gone(receive: Receive) -> None:
    """Waits until the caller has gone."""
    while (await receive())["type"] != "http.disconnect":
        pass


async def _lives(receive: Receive, send: Send) -> None:
    """Answers the server's lifespan events, which need no work here."""
    while True:
        message = await receive()
        await send({"type": f"{message['type']}.complete"})
        if message["type"] == "lifespan.shutdown":
            return

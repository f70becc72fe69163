"""Request at an HTTP edge, read whole; and its refusal, answered and on record."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.values import trace_context
from pep.base.access_token import is_access_token
from pep.base.errors import JournalError
from pep.gate import records
from pep.mcp.body_screen import BODY_BYTES, Unfit, screen
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from starlette.types import Message, Receive, Scope, Send

    from capabilities.values.trace_context import TraceIds
    from pep.base.ports import Clock
    from pep.request.authority import Credentials
    from pep.request.edge import Edge

TRACE: Final = "ztpm.trace"
"""Key in the ASGI scope under which the ids of the request's trace travel."""
CREDENTIALS: Final = "ztpm.credentials"
"""Key in the ASGI scope under which the verified credentials travel."""
HTTP_REQUEST: Final = "ztpm.knock"
"""Key in the ASGI scope under which the request that was read travels."""
SCHEME: Final = "dpop"
BEARER: Final = "bearer"
REFUSED_CODE: Final = -32_003
"""JSON-RPC code of a refusal at the door: ours, of the range that is left to servers."""
REFUSALS_AT_ONCE: Final = 4
"""Refusals recorded at the same time.

A flood of strangers must not queue up before a decision's record.
"""
JSON: Final = b"application/json"
BODILESS: Final = frozenset({"GET", "DELETE", "HEAD", "OPTIONS"})


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """One HTTP request, read.

    Attributes:
        method: of HTTP.
        headers: lower-case names; None where a name came more than once.
        body: whole.
        rpc: the screened JSON-RPC object; empty for a method without body.
    """

    method: str
    headers: Mapping[str, str | None]
    body: bytes
    rpc: Mapping[str, Any]

    @property
    def calls(self) -> bool:
        """True where the body asks for a tool."""
        return self.rpc.get("method") == "tools/call"

    @property
    def tool(self) -> str | None:
        """Name of the tool that is called, as the body says, or None."""
        params = self.rpc.get("params") if self.calls else None
        name = params.get("name") if isinstance(params, dict) else None
        return name if isinstance(name, str) else None


def headers_of(scope: Scope) -> dict[str, str | None]:
    """The headers by lower-case name; None where a name came more than once."""
    found: dict[str, str | None] = {}
    for raw_name, raw_value in scope["headers"]:
        name = raw_name.decode("latin-1").lower()
        found[name] = None if name in found else raw_value.decode("latin-1")
    return found


def token_in(headers: Mapping[str, str | None]) -> str | None:
    """Token text of `Authorization: DPoP`, or None where it is absent or comes twice."""
    scheme, _, token = (headers.get("authorization") or "").partition(" ")
    return token if scheme.lower() == SCHEME and token else None


def access_in(headers: Mapping[str, str | None]) -> tuple[str, bool] | None:
    """Access token of an OAuth client, and whether it came as `Bearer`; None where there is none [OAT-1]."""
    scheme, _, token = (headers.get("authorization") or "").partition(" ")
    if scheme.lower() not in {SCHEME, BEARER} or not is_access_token(token):
        return None
    return token, scheme.lower() == BEARER


def trace_of(headers: Mapping[str, str | None], rpc: Mapping[str, Any]) -> TraceIds | None:
    """Ids of the caller's trace: those that its body names, which its proof covers; else those of the header.

    A header of the same trace is nearer: it is of the tool server that passed the request on.
    """
    params = rpc.get("params")
    meta = params.get("_meta") if isinstance(params, dict) else None
    told = trace_context.read(meta.get(trace_context.HEADER)) if isinstance(meta, dict) else None
    carried = trace_context.read(headers.get(trace_context.HEADER))
    same = told is None or (carried is not None and carried.trace_id == told.trace_id)
    return carried if same else told


def rpc_of(method: str, body: bytes) -> Mapping[str, Any] | Unfit:
    """The JSON-RPC object of a request; empty for a method that has no body."""
    if method in BODILESS:
        return Unfit(Reason.BODY_MALFORMED, "a body where none belongs") if body else {}
    return screen(body)


async def read_body(receive: Receive) -> bytes | None:
    """The body, cut off once it is longer than `BODY_BYTES`; None when the client has gone."""
    chunks: list[bytes] = []
    size = 0
    while size <= BODY_BYTES:
        message = await receive()
        if message["type"] != "http.request":
            return None
        chunk = message.get("body", b"")
        chunks.append(chunk)
        size += len(chunk)
        if not message.get("more_body", False):
            break
    return b"".join(chunks)


def replayed(body: bytes, receive: Receive) -> Receive:
    """A `receive` that gives exactly the verified bytes, then every later message."""
    given = False

    async def again() -> Message:
        nonlocal given
        if not given:
            given = True
            return {"type": "http.request", "body": body, "more_body": False}
        return await receive()

    return again


def digest(body: bytes) -> str:
    """SHA-256 (hex), for the record."""
    return hashlib.sha256(body).hexdigest()


def short(text: object) -> str | None:
    """Text of a stranger, shortened for the record."""
    return text[:64] if isinstance(text, str) else None


async def answer(
    send: Send,
    status: int,
    body: bytes,
    headers: Sequence[tuple[bytes, bytes]] = (),
    *,
    media: bytes = JSON,
    bodiless: bool = False,
) -> None:
    """Sends a JSON body of that media type, or only what is said of it, which no cache may keep."""
    fixed = [
        (b"content-type", media),
        (b"content-length", str(len(body)).encode()),
        (b"cache-control", b"no-store"),
    ]
    await send({"type": "http.response.start", "status": status, "headers": [*fixed, *headers]})
    await send({"type": "http.response.body", "body": b"" if bodiless else body})


class Refusals:
    """Refused requests: each on record, and answered with the reason code alone.

    Args:
        edge: takes records.
        clock: both clocks.
    """

    def __init__(self, edge: Edge, clock: Clock) -> None:
        self._edge = edge
        self._clock = clock
        self._recording = asyncio.Semaphore(REFUSALS_AT_ONCE)

    async def refuse(
        self,
        send: Send,
        status: int,
        reason: Reason,
        *,
        credentials: Credentials | None,
        where: Mapping[str, object],
        headers: Sequence[tuple[bytes, bytes]] = (),
    ) -> None:
        """Refuses the request, on record where that is still possible.

        Args:
            send: of its connection.
            status: of HTTP.
            reason: the code.
            credentials: as far as they were verified; None when they were not looked at.
            where: known parts of the request, as in `records.refusal`.
            headers: further ones of the answer.
        """
        await self.record(status, reason, credentials=credentials, where=where)
        # Clients of MCP read the JSON-RPC error, and show its message.
        error = {"jsonrpc": "2.0", "id": None, "error": {"code": REFUSED_CODE, "message": str(reason)}}
        told = {"decision": "DENY", "reason": str(reason), **error}
        await answer(send, status, json.dumps(told).encode(), headers)

    async def record(
        self, status: int, reason: Reason, *, credentials: Credentials | None, where: Mapping[str, object]
    ) -> None:
        """Puts the refusal of a request on record where that is still possible.

        Args:
            status: of HTTP.
            reason: the code.
            credentials: as for `refuse`.
            where: likewise.
        """
        body = records.refusal(
            at=self._clock.wall_s(),
            at_ms=self._clock.monotonic_ms(),
            reason=reason,
            status=status,
            credentials=credentials,
            where=where,
        )
        async with self._recording:
            # Refused either way; only the journal's own state has got worse, and that denies every effect by itself.
            with contextlib.suppress(JournalError):
                await self._edge.record("refusal", body)

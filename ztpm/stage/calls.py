"""Calls of an agent: the MCP SDK's own client over streamable HTTP, each request signed, the exchange kept.

What is kept is what a thief on the path would have: the request line, headers and body. `resend` plays it again.
"""

from __future__ import annotations

import json
import os
import ssl
import time
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import anyio
import httpx2
from mcp import Client
from mcp.client.streamable_http import streamable_http_client

from pep.mcp.decision_result import DECISION_META

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class Exchange:
    """One HTTP request as it went over the wire, and the status that came back."""

    method: str
    url: str
    headers: Mapping[str, str]
    body: bytes
    status: int
    answer: bytes


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to one call.

    Attributes:
        status: HTTP status of the decisive exchange.
        decision: PERMIT, DENY or DEFER, as the server said it.
        reason: its reason code.
        tier: the runtime tier, or None.
        content: the structured content, whole; of a denial or deferral the decision.
        latency_ms: from sending to the answer; for a motion, until it ended.
        exchange: the decisive exchange.
    """

    status: int
    decision: str
    reason: str
    tier: int | None
    content: dict[str, Any] = field(default_factory=dict)
    latency_ms: float = 0.0
    exchange: Exchange | None = None


def call(
    url: str, auth: httpx2.Auth, tool: str, arguments: dict[str, object], meta: dict[str, Any] | None = None
) -> Answer:
    """Answer to one tool call through the SDK's client.

    Args:
        url: of the MCP server.
        auth: signs each HTTP request.
        tool: name of the tool.
        arguments: of the call.
        meta: `_meta` of the call.
    """
    return anyio.run(_call, url, auth, tool, arguments, meta)


@cache
def _certificates(file: str | None) -> ssl.SSLContext:
    """Certificates that are believed: read once, since a call takes less time than they do."""
    return ssl.create_default_context(cafile=file)


async def _call(
    url: str, auth: httpx2.Auth, tool: str, arguments: dict[str, object], meta: dict[str, Any] | None
) -> Answer:
    kept: list[Exchange] = []

    async def keep(response: httpx2.Response) -> None:
        await response.aread()
        request = response.request
        kept.append(
            Exchange(
                request.method,
                str(request.url),
                dict(request.headers),
                request.content,
                response.status_code,
                response.content,
            )
        )

    verify = _certificates(os.environ.get("SSL_CERT_FILE"))
    async with httpx2.AsyncClient(auth=auth, event_hooks={"response": [keep]}, timeout=60.0, verify=verify) as http:
        started = time.perf_counter()
        try:
            async with Client(streamable_http_client(url, http_client=http)) as client:
                started = time.perf_counter()
                result = await client.call_tool(tool, arguments, meta=meta)  # type: ignore[arg-type]
        except Exception:
            # The SDK reports a refused HTTP request in several ways; the answer on the wire is the observation.
            # It also asks for the tools after a call: when authority ended meanwhile, that is refused, the call is not.
            if not kept or kept[-1].status < 400:
                raise
            answered = (e for e in reversed(kept) if b'"tools/call"' in e.body and e.status < 400)
            return spoken(next(answered, kept[-1]), (time.perf_counter() - started) * 1e3)
        latency_ms = (time.perf_counter() - started) * 1e3
    decision = (result.meta or {}).get(DECISION_META) or {}
    content = result.structured_content if isinstance(result.structured_content, dict) else decision
    return Answer(
        status=kept[-1].status,
        decision=str(decision.get("decision", "NONE")),
        reason=str(decision.get("reason", "NONE")),
        tier=decision.get("tier"),
        content=content,
        latency_ms=latency_ms,
        exchange=next((e for e in reversed(kept) if b'"tools/call"' in e.body), kept[-1]),
    )


def spoken(exchange: Exchange, latency_ms: float) -> Answer:
    """Answer in the body of one exchange, refused at the door or by the tool."""
    decided, content = _said(exchange.answer)
    return Answer(
        status=exchange.status,
        decision=str(decided.get("decision", "NONE")),
        reason=str(decided.get("reason", "NONE")),
        tier=decided.get("tier"),
        content=content,
        latency_ms=latency_ms,
        exchange=exchange,
    )


def _said(answer: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Decision and content of a body: a refusal's own object, or those of a JSON-RPC result."""
    text = answer.decode("utf-8", "replace")
    lines = [line.removeprefix("data:") for line in text.splitlines() if line.startswith("data:")] or [text]
    for line in lines:
        try:
            body = json.loads(line)
        except ValueError:
            continue
        if isinstance(body, dict):
            result = body.get("result")
            decided = result.get("_meta", {}).get(DECISION_META) if isinstance(result, dict) else None
            if not isinstance(result, dict) or not isinstance(decided, dict):
                return body, body
            content = result.get("structuredContent")
            return decided, content if isinstance(content, dict) else decided
    return {}, {}


def send(auth: httpx2.Auth, url: str, body: bytes, headers: Mapping[str, str]) -> Answer:
    """The answer to one POST with a body that no well-behaved client would write, properly signed."""
    with httpx2.Client(auth=auth, timeout=30.0) as http:
        return post(http, url, body, headers)


def post(http: httpx2.Client, url: str, body: bytes, headers: Mapping[str, str]) -> Answer:
    """The answer to one POST over a client that is kept for several."""
    started = time.perf_counter()
    response = http.post(url, content=body, headers=dict(headers))
    exchange = Exchange("POST", url, dict(headers), body, response.status_code, response.content)
    return spoken(exchange, (time.perf_counter() - started) * 1e3)


def resend(exchange: Exchange, *, headers: Mapping[str, str] | None = None, body: bytes | None = None) -> Answer:
    """The answer to the same bytes once more, with some headers or the body exchanged.

    Args:
        exchange: the earlier exchange.
        headers: replaces headers of the same name, written in lower case.
        body: replaces the body.
    """
    sent = {k: v for k, v in {**exchange.headers, **(headers or {})}.items() if k not in {"content-length", "host"}}
    content = exchange.body if body is None else body
    started = time.perf_counter()
    with httpx2.Client(timeout=30.0) as http:
        response = http.request(exchange.method, exchange.url, headers=sent, content=content)
    again = Exchange(exchange.method, exchange.url, sent, content, response.status_code, response.content)
    return spoken(again, (time.perf_counter() - started) * 1e3)

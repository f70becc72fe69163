"""The HTTP edge of an MCP server: screen the body, verify token and proof, and only then let the request in.

Token and proof come as RFC 9449 says (`Authorization: DPoP`, `DPoP`), and the proof also covers the body. A fault of
the steps 1 to 10 is answered with 401 and the RFC 9728 pointer; the body tells strangers the reason code and nothing
else. Every refusal is on record.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from capabilities import jws, meta
from capabilities.errors import Fault, FaultCode
from pep import records
from pep.authority import Credentials, Presented
from pep.errors import JournalError
from pep.mcp.body import BODY_BYTES, Unfit, screen
from pep.mcp.mapping import bare_request
from pep.operations import Kind
from policies.reasons import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from pep.authority import Authority
    from pep.gate import Gate
    from pep.mcp.mapping import ToolBinding
    from pep.ports import Clock

CREDENTIALS: Final = "ztpm.credentials"
"""Key in the ASGI scope under which the verified credentials travel to the guard."""
ALGORITHMS: Final = (jws.EDDSA, jws.ES256)
"""Of proofs; the holder's key says which."""
SCHEME: Final = "dpop"
WELL_KNOWN: Final = "/.well-known/oauth-protected-resource"
REFUSALS_AT_ONCE: Final = 4
"""Refusals recorded at the same time; a flood of strangers must not queue up before a decision's record."""
BODILESS: Final = frozenset({"GET", "DELETE", "HEAD", "OPTIONS"})


@dataclass(frozen=True, slots=True)
class Knock:
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
    def tool(self) -> str | None:
        """Name of the tool that is called, as the body says, or None."""
        if self.rpc.get("method") != "tools/call":
            return None
        params = self.rpc.get("params")
        name = params.get("name") if isinstance(params, dict) else None
        return name if isinstance(name, str) else None


class DPoPLayer:
    """The ASGI layer around an MCP server's app.

    Args:
        app: the MCP server's.
        authority: steps 1 to 10.
        gate: takes records, knows leases.
        bindings: the tools, by name; they choose the lease, and stops need no credentials.
        audience: canonical URL of the server, also the `htu` of every proof.
        issuer: of the tokens, for the metadata.
        clock: both clocks.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        authority: Authority,
        gate: Gate,
        bindings: Mapping[str, ToolBinding],
        audience: str,
        issuer: str,
        clock: Clock,
    ) -> None:
        parts = urlsplit(audience)
        self._app = app
        self._authority = authority
        self._gate = gate
        self._bindings = bindings
        self._audience = audience
        self._clock = clock
        self._path = parts.path
        self._metadata_path = f"{WELL_KNOWN}{parts.path}"
        self._metadata_url = f"{parts.scheme}://{parts.netloc}{self._metadata_path}"
        self._metadata = json.dumps(
            {
                "resource": audience,
                "authorization_servers": [issuer],
                "dpop_bound_access_tokens_required": True,
                "dpop_signing_alg_values_supported": list(ALGORITHMS),
            }
        ).encode()
        self._recording = asyncio.Semaphore(REFUSALS_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await self._http(scope, receive, send)
        else:
            # No other protocol is served; for a websocket this is the ASGI form of 403.
            await send({"type": "websocket.close", "code": 1008})

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == self._metadata_path and scope["method"] == "GET":
            await _answer(send, 200, self._metadata)
            return
        if scope["path"] != self._path or scope["query_string"]:
            await _answer(send, 404, b"")
            return
        method = scope["method"]
        body = await _read(receive)
        if body is None:
            return
        rpc = self._rpc(method, body)
        if isinstance(rpc, Unfit):
            await self._refuse(
                send, 400, rpc.reason, None, {"method": method, "body": _digest(body), "detail": rpc.detail}
            )
            return
        knock = Knock(method, _headers(scope), body, rpc)
        credentials = self._credentials(knock)
        fault = credentials.fault
        binding = self._bindings.get(knock.tool or "")
        if fault is not None and not (binding is not None and binding.operation.kind is Kind.STOP):
            where = {
                "method": method,
                "rpc": _short(rpc.get("method")),
                "tool": _short(knock.tool),
                "body": _digest(body),
            }
            await self._refuse(send, 401, Reason(fault.code), credentials, where)
            return
        scope[CREDENTIALS] = credentials
        await self._app(scope, _replay(body, receive), send)

    def _rpc(self, method: str, body: bytes) -> Mapping[str, Any] | Unfit:
        if method in BODILESS:
            return Unfit(Reason.BODY_MALFORMED, "a body where none belongs") if body else {}
        return screen(body)

    def _credentials(self, knock: Knock) -> Credentials:
        """Steps 1 to 10, with the lease of what the body asks for. Whatever breaks on the way is a fault."""
        binding = self._bindings.get(knock.tool or "")
        lease_ms = self._gate.lease_ms(None if binding is None else bare_request(binding, audience=self._audience))
        presented = meta.stray(knock.rpc.get("params")) or self._presented(knock)
        if isinstance(presented, Fault):
            return Credentials(None, presented)
        try:
            return self._authority.check(presented, lease_ms=lease_ms)
        except Exception as error:  # noqa: BLE001 - a verification that breaks has not verified
            return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "TOK-1", type(error).__name__))

    def _presented(self, knock: Knock) -> Presented | Fault:
        for name, code in (("authorization", FaultCode.TOKEN_MALFORMED), ("dpop", FaultCode.PROOF_MALFORMED)):
            if name in knock.headers and knock.headers[name] is None:
                return Fault(code, "TOK-1", f"the header {name} came more than once")
        scheme, _, token = (knock.headers.get("authorization") or "").partition(" ")
        return Presented(
            token=token if scheme.lower() == SCHEME and token else None,
            proof=knock.headers.get("dpop"),
            method=knock.method,
            url=self._audience,
            body=knock.body,
        )

    async def _refuse(
        self, send: Send, status: int, reason: Reason, credentials: Credentials | None, where: Mapping[str, object]
    ) -> None:
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
                await self._gate.record("refusal", body)
        headers: list[tuple[bytes, bytes]] = []
        if status == 401:
            proof = reason.startswith("PROOF") or reason is Reason.REPLAYED
            challenge = (
                f'DPoP error="{"invalid_dpop_proof" if proof else "invalid_token"}", error_description="{reason}", '
                f'algs="{" ".join(ALGORITHMS)}", resource_metadata="{self._metadata_url}"'
            )
            headers.append((b"www-authenticate", challenge.encode()))
        await _answer(send, status, json.dumps({"decision": "DENY", "reason": str(reason)}).encode(), headers)


async def _answer(send: Send, status: int, body: bytes, headers: list[tuple[bytes, bytes]] | None = None) -> None:
    fixed = [
        (b"content-type", b"application/json"),
        (b"content-length", str(len(body)).encode()),
        (b"cache-control", b"no-store"),
    ]
    await send({"type": "http.response.start", "status": status, "headers": [*fixed, *(headers or [])]})
    await send({"type": "http.response.body", "body": body})


async def _read(receive: Receive) -> bytes | None:
    """The body, at most one byte longer than allowed; None when the client has gone."""
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


def _replay(body: bytes, receive: Receive) -> Receive:
    """A `receive` that gives exactly the bytes that were verified, then whatever comes after."""
    given = False

    async def again() -> Message:
        nonlocal given
        if not given:
            given = True
            return {"type": "http.request", "body": body, "more_body": False}
        return await receive()

    return again


def _headers(scope: Scope) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for raw_name, raw_value in scope["headers"]:
        name = raw_name.decode("latin-1").lower()
        found[name] = None if name in found else raw_value.decode("latin-1")
    return found


def _digest(body: bytes) -> str:
    return hashlib.sha256(body).hexdigest()


def _short(text: object) -> str | None:
    """Text of a stranger, bounded, for the record."""
    return text[:64] if isinstance(text, str) else None

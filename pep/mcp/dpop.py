"""HTTP edge of an MCP server: screens the body, verifies token and proof, and only then admits the request.

Token and proof come as RFC 9449 says (`Authorization: DPoP`, `DPoP`), and the proof also covers the body. A fault of
the steps 1 to 10 is answered with 401 and the RFC 9728 pointer; the body tells strangers the reason code and nothing
else. Every refusal is on record.
"""

from __future__ import annotations

import secrets
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol
from urllib.parse import urlsplit

from capabilities import tracing
from capabilities.proof import mcp_meta
from capabilities.values import trace_context
from capabilities.values.errors import Fault, FaultCode
from pep.base import caller_place
from pep.base.access_token import TOKEN_BYTES
from pep.mcp.body_screen import Unfit
from pep.mcp.http_request import (
    CREDENTIALS,
    HTTP_REQUEST,
    TRACE,
    HttpRequest,
    Refusals,
    access_in,
    answer,
    digest,
    headers_of,
    read_body,
    replayed,
    rpc_of,
    short,
    token_in,
    trace_of,
)
from pep.mcp.mapping import bare_request, stops
from pep.mcp.resource_description import ALGORITHMS, ResourceDescription
from pep.request.authority import Credentials, PresentedRequest
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from starlette.types import ASGIApp, Receive, Scope, Send

    from pep.base.access_token import Looked
    from pep.base.operation_row import Operation
    from pep.base.ports import Clock
    from pep.request.authority import Authority
    from pep.request.edge import Edge


class AccessTokens(Protocol):
    """Port to the identity provider's answers about access tokens."""

    async def look(self, token: str) -> Looked | Fault:
        """The answer about this access token, or the fault of one that stands for nothing."""


class DPoPLayer:
    """The ASGI layer around an MCP server's app.

    Args:
        app: the MCP server's, or what passes on to it.
        authority: steps 1 to 10.
        edge: takes records, knows leases; the gate, where there is one.
        tools: their operations, by name; they choose the lease, and stops need no credentials.
        audience: canonical URL of the server, also the `htu` of every proof.
        issuer: of the tokens, for the metadata.
        clock: both clocks.
        access: answers about access tokens of OAuth clients; None: this server takes none.
        random: so many random bytes, for traces that begin here.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        authority: Authority,
        edge: Edge,
        tools: Mapping[str, Operation],
        audience: str,
        issuer: str,
        clock: Clock,
        access: AccessTokens | None = None,
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        parts = urlsplit(audience)
        self._app = app
        self._authority = authority
        self._edge = edge
        self._refusals = Refusals(edge, clock)
        self._tools = tools
        self._random = random
        self._access = access
        self._audience = audience
        self._path = parts.path
        self._metadata = ResourceDescription(audience=audience, issuer=issuer, bearer=access is not None)

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
        if self._metadata.is_at(scope):
            await self._metadata.tell(scope, send)
            return
        if scope["path"] != self._path or scope["query_string"]:
            await answer(send, 404, b"")
            return
        method = scope["method"]
        body = await read_body(receive)
        if body is None:
            return
        rpc, headers = rpc_of(method, body), headers_of(scope)
        caller = trace_of(headers, {} if isinstance(rpc, Unfit) else rpc)
        with tracing.entered(trace_context.REQUEST, caller, random=self._random):
            scope[TRACE] = tracing.current()
            if isinstance(rpc, Unfit):
                where: dict[str, object] = {"method": method, "body": digest(body), "detail": rpc.detail}
                await self._refuse(send, 400, rpc.reason, None, where)
                return
            await self._admitted(HttpRequest(method, headers, body, rpc), scope, receive, send)

    async def _admitted(self, http_request: HttpRequest, scope: Scope, receive: Receive, send: Send) -> None:
        credentials = await self._credentials_of(http_request)
        fault = credentials.fault
        if fault is not None and not stops(self._tools, http_request.tool):
            where = {
                "method": http_request.method,
                "rpc": short(http_request.rpc.get("method")),
                "tool": short(http_request.tool),
                "body": digest(http_request.body),
            }
            await self._refuse(send, 401, Reason(fault.code), credentials, where)
            return
        if credentials.holder is None:
            caller_place.stopping(scope)
        else:
            caller_place.proven(scope, credentials.holder)
        scope[CREDENTIALS], scope[HTTP_REQUEST] = credentials, http_request
        await self._app(scope, replayed(http_request.body, receive), send)

    async def _credentials_of(self, http_request: HttpRequest) -> Credentials:
        """Credentials of an agent, or of an OAuth client: a stop waits for no answer about either."""
        found = None if self._access is None else access_in(http_request.headers)
        if found is None or self._access is None or stops(self._tools, http_request.tool):
            return self._credentials(http_request)
        token, bearer = found
        presented = mcp_meta.stray(http_request.rpc.get("params")) or self._presented(http_request)
        if isinstance(presented, Fault):
            return Credentials(None, presented)
        if len(token) > TOKEN_BYTES:
            return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "OAT-1", "too long"))
        try:
            looked = await self._access.look(token)
            if isinstance(looked, Fault):
                return Credentials(None, looked)
            return self._authority.check_access(
                replace(presented, token=token), looked, bearer=bearer, lease_ms=self._lease_ms(http_request)
            )
        except Exception as error:  # noqa: BLE001 - a verification that breaks has not verified
            return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "OAT-2", type(error).__name__))

    def _lease_ms(self, http_request: HttpRequest) -> int:
        """The lease of the asked operation."""
        operation = self._tools.get(http_request.tool or "")
        return self._edge.lease_ms(None if operation is None else bare_request(operation, audience=self._audience))

    def _credentials(self, http_request: HttpRequest) -> Credentials:
        """Credentials after steps 1 to 10, with the lease of the asked operation.

        Every failure on the way is a fault.
        """
        lease_ms = self._lease_ms(http_request)
        presented = mcp_meta.stray(http_request.rpc.get("params")) or self._presented(http_request)
        if isinstance(presented, Fault):
            return Credentials(None, presented)
        try:
            return self._authority.check(presented, lease_ms=lease_ms)
        except Exception as error:  # noqa: BLE001 - a verification that breaks has not verified
            return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "TOK-1", type(error).__name__))

    def _presented(self, http_request: HttpRequest) -> PresentedRequest | Fault:
        for name, code in (("authorization", FaultCode.TOKEN_MALFORMED), ("dpop", FaultCode.PROOF_MALFORMED)):
            if name in http_request.headers and http_request.headers[name] is None:
                return Fault(code, "TOK-1", f"the header {name} came more than once")
        return PresentedRequest(
            token=token_in(http_request.headers),
            proof=http_request.headers.get("dpop"),
            method=http_request.method,
            url=self._audience,
            body=http_request.body,
        )

    async def _refuse(
        self, send: Send, status: int, reason: Reason, credentials: Credentials | None, where: Mapping[str, object]
    ) -> None:
        headers: list[tuple[bytes, bytes]] = []
        if status == 401:
            proof = reason.startswith("PROOF") or reason is Reason.REPLAYED
            challenge = (
                f'DPoP error="{"invalid_dpop_proof" if proof else "invalid_token"}", error_description="{reason}", '
                f'algs="{" ".join(ALGORITHMS)}", resource_metadata="{self._metadata.url}"'
            )
            if self._access is not None:
                # RFC 6750 section 3.1: a request without credentials is told no error.
                error = (
                    "" if reason is Reason.TOKEN_MISSING else f'error="invalid_token", error_description="{reason}", '
                )
                bearer = f'Bearer {error}resource_metadata="{self._metadata.url}"'
                headers.append((b"www-authenticate", bearer.encode()))
            headers.append((b"www-authenticate", challenge.encode()))
        await self._refusals.refuse(send, status, reason, credentials=credentials, where=where, headers=headers)

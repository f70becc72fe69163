"""Edge of an MCP server for messages without an HTTP request: over stdio, and in the server's own process.

It is the outermost middleware of the SDK's server. Token and proof come in `_meta` ([PRF-10] in docs/spec.md), are
verified as over HTTP, and go no further. Every refusal is on record, and tells strangers the reason code alone.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from mcp import MCPError
from mcp_types.methods import SPEC_CLIENT_NOTIFICATION_METHODS

from capabilities import tracing
from capabilities.proof import mcp_meta
from capabilities.values import trace_context
from capabilities.values.errors import Fault, FaultCode
from pep.mcp.body_screen import BODY_BYTES
from pep.mcp.http_request import (
    CREDENTIALS,
    HTTP_REQUEST,
    REFUSED_CODE,
    TRACE,
    HttpRequest,
    Refusals,
    digest,
    short,
    trace_of,
)
from pep.mcp.mapping import bare_request, stops
from pep.request.authority import Credentials, PresentedRequest
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mcp.server.context import CallNext, HandlerResult, ServerRequestContext

    from capabilities.proof.mcp_meta import UnverifiedRequest
    from pep.base.operation_row import Operation
    from pep.base.ports import Clock
    from pep.request.authority import Authority
    from pep.request.edge import Edge

OPEN: Final = frozenset({"initialize", "server/discover", "ping"}) | SPEC_CLIENT_NOTIFICATION_METHODS
"""Methods that carry no authority, and that a client's SDK sends on its own."""
UNVERIFIED: Final = 401
"""Status on record of faulty credentials, the one that HTTP would have told."""
UNREAD: Final = 400
"""Status on record of a message that is too large, likewise."""


@dataclass(frozen=True, slots=True)
class Message:
    """A verified message, where the SDK keeps the HTTP request of a message that has one.

    Attributes:
        scope: with the keys of an ASGI scope under which credentials, trace and request travel.
        headers: none.
    """

    scope: dict[str, Any]
    headers: Mapping[str, str] = field(default_factory=dict)


class MessageEdge:
    """The middleware before all others of a guarded server.

    Args:
        authority: steps 1 to 10.
        edge: takes records, knows leases; the gate.
        tools: their operations, by name; they choose the lease, and stops need no credentials.
        audience: canonical URL of the server, also the `htu` of every proof.
        clock: both clocks.
        random: so many random bytes, for traces that begin here.
    """

    def __init__(
        self,
        *,
        authority: Authority,
        edge: Edge,
        tools: Mapping[str, Operation],
        audience: str,
        clock: Clock,
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        self._authority = authority
        self._edge = edge
        self._refusals = Refusals(edge, clock)
        self._tools = tools
        self._audience = audience
        self._random = random

    async def __call__(self, ctx: ServerRequestContext[Any, Any], call_next: CallNext) -> HandlerResult:
        """One message; a request over HTTP has passed an edge of its own."""
        if ctx.request is not None:
            return await call_next(ctx)
        caller = trace_of({}, {"params": ctx.params})
        with tracing.entered(trace_context.REQUEST, caller, random=self._random):
            return await self._admitted(ctx, call_next)

    async def _admitted(self, ctx: ServerRequestContext[Any, Any], call_next: CallNext) -> HandlerResult:
        params = None if ctx.params is None else mcp_meta.stripped(ctx.params)
        rpc = {"method": ctx.method, "params": params}
        message = HttpRequest(mcp_meta.method(ctx.method), {}, b"", rpc)
        scope: dict[str, Any] = {TRACE: tracing.current(), HTTP_REQUEST: message}
        shown = mcp_meta.detach(ctx.params, rpc_method=ctx.method)
        # The SDK's own client lists tools after a call, without the `_meta` of that call; the list is nobody's then.
        bare = ctx.method == "tools/list" and not isinstance(shown, Fault) and shown.token is shown.proof is None
        if ctx.method not in OPEN and not bare:
            if not isinstance(shown, Fault) and len(shown.body) > BODY_BYTES:
                await self._refuse(ctx, message, shown, None, Reason.BODY_TOO_LARGE)
                return None
            credentials = self._credentials(message, shown)
            fault = credentials.fault
            if fault is not None and not stops(self._tools, message.tool):
                await self._refuse(ctx, message, shown, credentials, Reason(fault.code))
                return None
            scope[CREDENTIALS] = credentials
        meta: Any = {name: value for name, value in (ctx.meta or {}).items() if name not in mcp_meta.CREDENTIALS}
        passed = replace(ctx, params=params, meta=None if ctx.meta is None else meta, request=Message(scope))
        return await call_next(passed)

    def _credentials(self, message: HttpRequest, shown: UnverifiedRequest | Fault) -> Credentials:
        """Credentials after steps 1 to 10, with the lease of the asked operation; every failure is a fault."""
        if isinstance(shown, Fault):
            return Credentials(None, shown)
        operation = self._tools.get(message.tool or "")
        lease_ms = self._edge.lease_ms(None if operation is None else bare_request(operation, audience=self._audience))
        presented = PresentedRequest(shown.token, shown.proof, shown.method, self._audience, shown.body)
        try:
            return self._authority.check(presented, lease_ms=lease_ms)
        except Exception as error:  # noqa: BLE001 - a verification that breaks has not verified
            return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "TOK-1", type(error).__name__))

    async def _refuse(
        self,
        ctx: ServerRequestContext[Any, Any],
        message: HttpRequest,
        shown: UnverifiedRequest | Fault,
        credentials: Credentials | None,
        reason: Reason,
    ) -> None:
        """Refuses a message, on record where that is still possible.

        Raises:
            MCPError: with the code that the body of a refusal over HTTP has; a notification is dropped.
        """
        body = b"" if isinstance(shown, Fault) else shown.body
        where = {"method": short(message.method), "tool": short(message.tool), "body": digest(body)}
        status = UNREAD if credentials is None else UNVERIFIED
        await self._refusals.record(status, reason, credentials=credentials, where=where)
        if ctx.request_id is not None:
            raise MCPError(code=REFUSED_CODE, message=str(reason))

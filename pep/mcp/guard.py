"""Guard inside a tool server: every `tools/call`, of any tool, runs through the gate.

    from pep.mcp.guard import guard

    app = guard(server, gate=..., authority=..., ...)

is the addition to an existing `MCPServer`, FastMCP server, or low-level server of the SDK; `pep.mcp.guard` itself is
this module. A tool that is not in the guard's table cannot be called at all.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast
from urllib.parse import urlsplit

from mcp import MCPError
from mcp.server.lowlevel.server import HandlerEntry, Server
from mcp.server.mcpserver import MCPServer
from mcp_types import CallToolRequestParams, CallToolResult, PaginatedRequestParams

from capabilities import tracing
from capabilities.values import trace_context
from capabilities.values.chain import Chain
from pep.base.errors import ActuationRefusedError, JournalError, UpstreamError
from pep.base.traced import tell
from pep.gate import records
from pep.mcp import deferred_result, fastmcp_server, tool_listing
from pep.mcp.decision_result import DECISION_META, DeniedCalls, effect_of, told_result, untold, with_meta
from pep.mcp.deferred_task import DeferredTasks
from pep.mcp.dpop import DPoPLayer
from pep.mcp.http_request import CREDENTIALS, TRACE
from pep.mcp.mapping import Misfit, decided_arguments, rounded, stops, to_request
from pep.mcp.message_edge import MessageEdge
from pep.mcp.passed_task import PassedTask
from pep.mcp.provenance import Unreadable, shown, unvouched, wanted
from pep.mcp.real_paths import resolved_request
from pep.mcp.session_layer import http_app
from pep.mcp.tool_digest import definition_digest, refuse_changed
from pep.mcp.tool_listing import ShownTools
from pep.request.authority import NOBODY
from pep.request.call import Call, tool_reading
from pep.request.permit import Permit, PermitScope
from policies.evidence.evidence import NOT_COLLECTED, NotCollected
from policies.evidence.model import Effect
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence

    from mcp.server.context import HandlerResult, ServerRequestContext
    from mcp_types import ListToolsResult, Tool
    from starlette.types import ASGIApp

    from pep.base.operation_row import Operation
    from pep.base.ports import Clock, Readiness, Registry
    from pep.gate.gate import EffectResult, Gate, GateResult
    from pep.journal.task_store import TaskStore
    from pep.mcp.deferred_task import AboutTask
    from pep.mcp.dpop import AccessTokens
    from pep.mcp.fastmcp_server import FastMCPServer
    from pep.mcp.provenance import Vouching
    from pep.people.asks import Asks
    from pep.request.authority import Authority, Credentials
    from policies.evidence.content_readings import ContextReading
    from policies.evidence.evidence import ToolReading

    CallTool = Callable[[ServerRequestContext[Any, Any], CallToolRequestParams], Awaitable[HandlerResult]]
    CallContext: TypeAlias = ServerRequestContext[Any, Any]
    ServedTool: TypeAlias = Tool
    ServedTools: TypeAlias = Sequence[ServedTool]
    ListTools = Callable[[CallContext, str], Awaitable[ServedTools]]
    ListedTools = Callable[[CallContext, str], ServedTools]

SdkServer: TypeAlias = "MCPServer[Any] | Server[Any]"
AnyServer: TypeAlias = "MCPServer[Any] | Server[Any] | FastMCPServer"
EXTENSION: Final = "dev.ztpm/pep"
SETTINGS: Final[Mapping[str, Any]] = {"version": "1", "proof": ["dpop"]}
"""Told to clients under `EXTENSION`."""


class Guard:
    """Guard before every tool of a server.

    Args:
        call: the server's own answer to a call.
        served: the tools of a name as the server lists them now, to the asker of a context; others may be among them.
        listed: the same as it listed them last, where that will do; none where it is to be asked.
        gate: decides and enforces.
        registry: approved definitions and base tiers.
        tools: operations of the tools that may be called, by name.
        asks: state of deferrals, for a retry that waits.
        readiness: of the robot, for these tools.
        audience: canonical URL of the server.
        clock: both clocks.
        vouching: provenance of values; None where nothing is known of it: no receipt is believed, and none given.
        declared: abilities of clients; None: of those alone that state them with each request.
        tasks: calls that wait for people, for clients that look after them; None: no client can.
    """

    def __init__(
        self,
        *,
        call: CallTool,
        served: ListTools,
        listed: ListedTools = lambda _, __: (),
        gate: Gate,
        registry: Registry,
        tools: Mapping[str, Operation],
        asks: Asks,
        readiness: Readiness | None,
        audience: str,
        clock: Clock,
        vouching: Vouching | None = None,
        declared: deferred_result.Declared | None = None,
        tasks: DeferredTasks | None = None,
    ) -> None:
        self._vouching = vouching
        self._patience = deferred_result.Patience(asks)
        self._denied_calls = DeniedCalls(gate, clock)
        self._declared = declared or deferred_result.Declared()
        self._tasks = tasks
        self._call = call
        self._served = served
        self._listed = listed
        self._gate = gate
        self._readiness = readiness
        self._registry = registry
        self._tools = tools
        self._audience = audience
        self._clock = clock

    async def __call__(self, ctx: ServerRequestContext[Any, Any], params: CallToolRequestParams) -> HandlerResult:
        """The tool's own result when the call is permitted, else a denial or deferral in its place."""
        # What is current here is of the server's own task.
        with tracing.rejoined(None if ctx.request is None else ctx.request.scope.get(TRACE)):
            return await self._answered(ctx, params)

    def shown(self, ctx: ServerRequestContext[Any, Any], served: Iterable[Tool]) -> frozenset[str]:
        """Names of the served tools that the caller of a request may use."""
        return tool_listing.shown(served, _credentials_of(ctx), tools=self._tools, registry=self._registry)

    async def _answered(self, ctx: ServerRequestContext[Any, Any], params: CallToolRequestParams) -> HandlerResult:
        arrived_ms, at = self._clock.monotonic_ms(), self._clock.wall_s()
        credentials = _credentials_of(ctx)
        operation = self._tools.get(params.name)
        if operation is None:
            return await self._denied_calls.deny(Reason.TOOL_UNKNOWN, "TEA-3", credentials, {"tool": params.name[:64]})
        if stops(self._tools, params.name):
            return await self._stop(operation, credentials, ctx, params)
        if credentials.fault is not None:
            return await self._denied_calls.deny(
                Reason(credentials.fault.code), "AID-1", credentials, {"tool": params.name}
            )
        request = resolved_request(
            operation, params.arguments or {}, request_id=secrets.token_hex(16), audience=self._audience, at=at
        )
        if isinstance(request, Misfit):
            where: dict[str, object] = {"tool": params.name, "argument": request.argument, "detail": request.detail}
            return await self._denied_calls.deny(request.reason, "TEA-2", credentials, where)
        presented = shown(params.meta)
        if isinstance(presented, Unreadable):
            unread: dict[str, object] = {"tool": params.name, "argument": "_meta", "detail": presented.detail}
            return await self._denied_calls.deny(Reason.BODY_MALFORMED, "CII-5", credentials, unread)
        try:
            tool = await self._tool(operation, ctx, recent=operation.robot is None)
        except UpstreamError as error:
            away: dict[str, object] = {"tool": params.name, "detail": error.detail}
            return await self._denied_calls.deny(Reason.UPSTREAM_UNREACHABLE, "TEA-3", credentials, away)
        if self._tools.get(params.name) is not operation:  # it was read by the row of an earlier definition
            return await self._denied_calls.deny(
                Reason.TOOL_DEFINITION_CHANGED, "TEA-3", credentials, {"tool": params.name}
            )
        context: ContextReading | NotCollected = NOT_COLLECTED
        if isinstance(credentials.chain, Chain):
            weigh = unvouched if self._vouching is None else self._vouching.context
            weighed = partial(weigh, request, presented, operation=operation, chain=credentials.chain, at=at)
            # A receipt costs half a millisecond, and a call may show sixteen: others have their turn meanwhile.
            context = await asyncio.to_thread(weighed) if presented else weighed()

        sent = params
        if operation.robot is None:
            # The tool gets the arguments that were decided, and no others.
            sent = params.model_copy(
                update={"arguments": decided_arguments(operation, request, params.arguments or {})}
            )

        async def effect(permit: Permit) -> EffectResult:
            if operation.robot is None:
                await refuse_changed(tool, partial(self._tool, operation, ctx))
                again = to_request(operation, sent.arguments or {}, request_id="", audience=self._audience, at=at)
                permit.spend_act(digest="" if isinstance(again, Misfit) else again.digest)
            with PermitScope(permit), tracing.step(trace_context.EFFECT, {trace_context.OPERATION: operation.name}):
                try:
                    outcome = await self._call(ctx, sent)
                except MCPError as error:  # an answer of the tool's own, which is no result
                    outcome = error.error
            if permit.refusal is not None:
                raise ActuationRefusedError(permit.refusal)
            return effect_of(outcome)

        call = Call(
            request=request,
            operation=operation,
            tool=tool,
            credentials=credentials,
            arrived_ms=arrived_ms,
            readiness=self._readiness,
            context=context,
        )
        if deferred_result.is_retry(params):
            await self._patience.wait(params, chain=credentials.chain, request=request)
        with tracing.step(trace_context.DECIDE, {trace_context.OPERATION: operation.name}) as span:
            answer = await self._gate.run(call, effect)
            tell(span, answer.decision)
        if wanted(params.meta):
            answer = await self._vouched(answer, call, ctx)
        changed = {} if operation.robot is not None else rounded(params.arguments or {}, sent.arguments or {})
        return await self._told(answer, call, ctx, params, rounded=changed)

    async def _told(
        self,
        answer: GateResult,
        call: Call,
        ctx: ServerRequestContext[Any, Any],
        params: CallToolRequestParams,
        *,
        rounded: Mapping[str, Any],
    ) -> HandlerResult:
        """The answer in the form that its caller's client understands; of a deferral there are four."""
        told = told_result(answer, tool=call.tool, rounded=rounded)
        if isinstance(told, PassedTask) and self._tasks is not None:
            return await self._tasks.adopted(told, ctx)
        if answer.decision.effect is not Effect.DEFER or not isinstance(told, CallToolResult) or answer.observed:
            return told
        asked: HandlerResult = deferred_result.elicitation(
            answer, params, ctx, declared=self._declared.of(ctx), otherwise=told
        )
        if asked is None and self._tasks is not None:
            asked = await self._tasks.opened(answer, params, ctx, told)
        return told if asked is None else asked

    async def _vouched(self, answer: GateResult, call: Call, ctx: ServerRequestContext[Any, Any]) -> GateResult:
        """The answer, with a receipt for its result where there is one and the tool is still as approved."""
        chain, result = call.credentials.chain, answer.result
        # A receipt names the proof of its call; a bearer has none.
        if (
            self._vouching is None
            or not call.credentials.proof_name
            or result is None
            or result.failed
            or not isinstance(chain, Chain)
        ):
            return answer
        if isinstance(call.context, NotCollected) or not isinstance(result.carried, CallToolResult):
            return answer
        try:
            if await self._tool(call.operation, ctx) != call.tool:
                return answer
        except UpstreamError:  # it was there for the call; the answer is as good, and nobody vouches for it
            return answer
        said = self._vouching.meta(
            result.carried.structured_content,
            request=call.request,
            reading=call.context,
            tool=call.tool,
            leaf=chain.leaf,
            proof=call.credentials.proof_name,
            at=self._clock.wall_s(),
        )
        return replace(answer, result=replace(result, carried=with_meta(result.carried, said)))

    async def _tool(
        self, operation: Operation, ctx: ServerRequestContext[Any, Any], *, recent: bool = False
    ) -> ToolReading:
        """The tool as it is registered, and as this server serves it at this moment.

        Args:
            operation: of the tool.
            ctx: of the request.
            recent: the server's latest list will do while it agrees with the registry: there is a last look.
        """
        listed = (recent and self._listed(ctx, operation.name)) or await self._served(ctx, operation.name)
        served = [tool for tool in listed if tool.name == operation.name]
        # Of two tools of one name nobody knows which would be called.
        digest = definition_digest(served[0]) if len(served) == 1 else ""
        reading = tool_reading(operation.name, self._registry.tool(operation.name), digest)
        if recent and reading.actual_digest != reading.approved_digest:
            return await self._tool(operation, ctx)
        return reading

    async def _stop(
        self,
        operation: Operation,
        credentials: Credentials,
        ctx: ServerRequestContext[Any, Any],
        params: CallToolRequestParams,
    ) -> HandlerResult:
        """Stops first and records afterwards: a stop is never subject to a permit, and waits for nothing."""
        outcome = await self._call(ctx, params)
        fault = credentials.fault
        body: dict[str, object] = {
            "effect": "PERMIT",
            "operation": operation.name,
            "caller": credentials.chain.leaf.agent if isinstance(credentials.chain, Chain) and fault is None else None,
            "fault": None if fault is None else str(fault.code),
            "result": records.jsonable(dict(effect_of(outcome).value)),
        }
        # A stop that cannot be recorded is still a stop.
        with contextlib.suppress(JournalError):
            await self._gate.record("outcome", {"request_id": "stop", "decision": "", "outcome": "done", "stop": body})
        told = {"decision": "PERMIT", "reason": str(Reason.PERMITTED), "primitive": "", "tier": 0}
        return with_meta(outcome if fault is None else untold(outcome), {DECISION_META: told})


def guard(
    server: AnyServer,
    *,
    gate: Gate,
    authority: Authority,
    registry: Registry,
    tools: Mapping[str, Operation],
    asks: Asks,
    readiness: Readiness | None,
    audience: str,
    issuer: str,
    clock: Clock,
    vouching: Vouching | None = None,
    access: AccessTokens | None = None,
    served: ListTools | None = None,
    listed: ListedTools = lambda _, __: (),
    kept: TaskStore | None = None,
    about: AboutTask | None = None,
    sessions: bool = False,
) -> ASGIApp:
    """The guarded HTTP app of an existing server: no tool of it can be reached but through the gate.

    The server itself is guarded, too: over stdio, and for a client in this process.

    Args:
        server: its tools already added.
        gate: decides and enforces.
        authority: steps 1 to 10.
        registry: approved definitions and base tiers.
        tools: operations of the tools that may be called, by name.
        asks: state of deferrals.
        readiness: of the robot, for these tools; None without one.
        audience: canonical URL of the server; its path is where the app answers.
        issuer: of the tokens.
        clock: both clocks.
        vouching: provenance of values; None where nothing is known of it: no receipt is believed, and none given.
        access: answers about access tokens of OAuth clients; None: the server takes none.
        served: as for `Guard`; None: the server's whole list is asked for.
        listed: likewise; a server that is asked at once has none.
        kept: keeps deferred calls, for clients that can look after a task; None: a deferral is never one.
        about: as for `DeferredTasks`.
        sessions: kept over HTTP for clients of the protocol before 2026-07-28; else each of their requests is alone.

    Raises:
        ConfigError: a FastMCP server that cannot be guarded as it is.
        RuntimeError: when this SDK does not let the guard stand before the tools.
    """
    declared = deferred_result.Declared()
    denied_calls = DeniedCalls(gate, clock)
    tasks = None if kept is None else DeferredTasks(kept, asks=asks, denied=denied_calls, clock=clock, about=about)
    standing = partial(
        Guard,
        declared=declared,
        tasks=tasks,
        served=served or (lambda ctx, name: tools_of(server, ctx)),  # noqa: ARG005 - the list is the whole one
        listed=listed,
        gate=gate,
        registry=registry,
        tools=tools,
        asks=asks,
        readiness=readiness,
        audience=audience,
        clock=clock,
        vouching=vouching,
    )
    if fastmcp_server.is_fastmcp(server):
        foreign = cast("FastMCPServer", server)
        stands = standing(call=fastmcp_server.call)
        fastmcp_server.stand_before(foreign, stands, shown=stands.shown, extension=EXTENSION, settings=SETTINGS)
        app = fastmcp_server.app_of(foreign, urlsplit(audience))
    else:
        lease_ms = gate.lease_ms(None)

        def good(caller: Credentials) -> bool:
            return isinstance(authority.standing(caller, lease_ms=lease_ms), Chain)

        app = http_app(cast("SdkServer", server), audience, standing=good if sessions else None)
        _guard_tools(cast("SdkServer", server), standing)
    before_messages = MessageEdge(authority=authority, edge=gate, tools=tools, audience=audience, clock=clock)
    low = lowlevel(server)
    low.middleware[:0] = [before_messages, declared]
    if tasks is not None:
        tasks.serve(low)
    return DPoPLayer(
        app,
        authority=authority,
        edge=gate,
        tools=tools,
        audience=audience,
        issuer=issuer,
        clock=clock,
        access=access,
    )


def _guard_tools(server: SdkServer, standing: Callable[..., Guard]) -> None:
    """Puts the guard before the tools of one of the SDK's own servers."""
    low = lowlevel(server)
    own = low.get_request_handler("tools/call")
    if own is None:
        raise RuntimeError("the server has no tools")
    stands = standing(call=own.handler)
    low.add_request_handler("tools/call", CallToolRequestParams, stands)
    if (listed := low.get_request_handler("tools/list")) is not None:
        shows = ShownTools(listed.handler, stands.shown)  # type: ignore[arg-type]
        low.add_request_handler("tools/list", PaginatedRequestParams, shows)
    low.extensions[EXTENSION] = dict(SETTINGS)
    if low.get_request_handler("tools/call") != HandlerEntry(CallToolRequestParams, stands):
        raise RuntimeError("the guard does not stand before the tools")


def lowlevel(server: AnyServer) -> Server[Any]:
    """The SDK's low-level server behind a guarded one.

    Raises:
        RuntimeError: when this SDK is another one than the guard knows.
    """
    if fastmcp_server.is_fastmcp(server):
        return fastmcp_server.lowlevel(cast("FastMCPServer", server))
    sdk = cast("SdkServer", server)
    # An `MCPServer` names it nowhere but as the app of its session manager, which there is once it has an HTTP app.
    low = sdk if isinstance(sdk, Server) else sdk.session_manager.app
    if not isinstance(low, Server):
        raise RuntimeError("this MCP SDK is not known to the guard")  # noqa: TRY004 - no type of the caller's choice
    return low


async def tools_of(server: AnyServer, ctx: ServerRequestContext[Any, Any] | None = None) -> Sequence[Tool]:
    """The tools of a server as it lists them now.

    Args:
        server: with or without the SDK's own table of tools.
        ctx: of the request; None at start, when a server without such a table is asked for nobody.
    """
    if fastmcp_server.is_fastmcp(server):
        return await fastmcp_server.tools_of(cast("FastMCPServer", server))
    if isinstance(server, MCPServer):
        return await server.list_tools()
    own = cast("Server[Any]", server).get_request_handler("tools/list")
    if own is None:
        return ()
    answer = own.handler.own if isinstance(own.handler, ShownTools) else own.handler
    listed: ListToolsResult = await answer(ctx, PaginatedRequestParams())  # type: ignore[arg-type, assignment]
    return listed.tools


async def digests_of(server: AnyServer) -> dict[str, str]:
    """Digest of each tool's definition as the server lists it now, by name; "" for two of one name."""
    found: dict[str, str] = {}
    for tool in await tools_of(server):
        found[tool.name] = "" if tool.name in found else definition_digest(tool)
    return found


def _credentials_of(ctx: ServerRequestContext[Any, Any]) -> Credentials:
    """Credentials of this very request; a context variable could be an older request's of the same session."""
    return NOBODY if ctx.request is None else cast("Credentials", ctx.request.scope.get(CREDENTIALS, NOBODY))

"""FastMCP server behind the guard, through its public hooks: middleware, its list of tools, its HTTP app.

The guard is the outermost middleware, so the server's own, such as a cache, answers nobody whom the gate refuses. One
request is one act: what a tool calls through its server again has no credentials left. One private name is left, for
messages without HTTP (`lowlevel`).
"""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from mcp.server.lowlevel.server import Server
from mcp_types import CallToolRequestParams, CallToolResult, InputRequiredResult, TextContent

from pep.base.declaration import declared
from pep.base.errors import ConfigError, PepFault
from pep.mcp.http_request import CREDENTIALS, HTTP_REQUEST

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
    from urllib.parse import SplitResult

    from mcp_types import Tool
    from starlette.types import ASGIApp

    from pep.base.operation_row import Operation

MAJOR: Final = "4"
"""Major version of FastMCP whose hooks these are."""


class FastMCPServer(Protocol):
    """The public hooks of a FastMCP server that the guard uses."""

    auth: Any
    middleware: list[Any]

    async def list_tools(self) -> Sequence[Any]:
        """All tools, each version of each."""

    def http_app(self, **options: Any) -> ASGIApp:
        """The app."""


@dataclass(slots=True)
class _Context:
    """Context of one call, as the guard reads it, with the way on to the tool.

    Attributes:
        request: has the ASGI scope, with the credentials in it.
        session: of the client; None where there is none.
        protocol_version: of the connection.
        go_on: the server's own way from here.
        result: of the tool, as the server has it.
        told: the same in the SDK's form.
    """

    request: Any
    session: Any
    protocol_version: str
    go_on: Callable[[CallToolRequestParams], Awaitable[Any]]
    result: Any = None
    told: CallToolResult | None = None


_whole: ContextVar[bool] = ContextVar("_whole", default=False)
"""True while the guard itself asks for the list, which is every caller's then."""


def is_fastmcp(server: object) -> bool:
    """True for a server of the package `fastmcp`, which need not be installed."""
    return any(
        kind.__name__ == "FastMCP" and kind.__module__.partition(".")[0] == "fastmcp" for kind in type(server).__mro__
    )


async def tools_of(server: FastMCPServer) -> list[Tool]:
    """Definitions of the tools as it lists them now; a tool of two versions is there twice.

    Raises:
        ConfigError: a tool may run as a background task: its effect would come after its permit.
    """
    found: list[Tool] = []
    for each in await _listed(server):
        definition: Tool = each.to_mcp_tool()
        if definition.execution is not None and definition.execution.task_support not in {None, "forbidden"}:
            raise ConfigError(PepFault.CONFIG_INVALID, f"{each.name}: a guarded tool is no task; use task=False")
        found.append(definition)
    return found


async def _listed(server: FastMCPServer) -> Sequence[Any]:
    """The tools for nobody in particular, through the server's own middleware."""
    token = _whole.set(True)
    try:
        return await server.list_tools()
    finally:
        _whole.reset(token)


async def decorated(server: FastMCPServer) -> dict[str, Operation]:
    """Rows of the server's functions that declare one, by the name of their tool."""
    return {
        each.name: row for each in await _listed(server) if (row := declared(getattr(each, "fn", None))) is not None
    }


async def call(ctx: Any, params: CallToolRequestParams) -> Any:
    """The server's own answer to a permitted call, in the SDK's form."""
    from fastmcp.exceptions import FastMCPError
    from fastmcp.tools.base import InputRequiredToolResult, ToolResult

    try:
        ctx.result = await ctx.go_on(params)
    except FastMCPError as error:  # as the server tells it to its client
        return CallToolResult(content=[TextContent(type="text", text=str(error))], is_error=True)
    if isinstance(ctx.result, InputRequiredToolResult):
        return ctx.result.input_required
    if not isinstance(ctx.result, ToolResult):
        return ctx.result
    given = ctx.result
    ctx.told = CallToolResult(
        content=given.content, structured_content=given.structured_content, is_error=given.is_error, _meta=given.meta
    )
    return ctx.told


def stand_before(
    server: FastMCPServer,
    guard: Callable[[Any, CallToolRequestParams], Awaitable[Any]],
    *,
    shown: Callable[[Any, Iterable[Tool]], frozenset[str]],
    extension: str,
    settings: Mapping[str, Any],
) -> None:
    """Puts the guard before every tool of the server, and tells clients of it.

    Args:
        server: a FastMCP server.
        guard: decides each call.
        shown: names of the served tools that the caller of a request may use.
        extension: identifier under which clients are told.
        settings: told there.

    Raises:
        ConfigError: another major version, or a server that authenticates its callers itself.
    """
    import fastmcp
    from fastmcp.server.extensions import ServerExtension
    from fastmcp.tools.base import InputRequiredToolResult, ToolResult

    if fastmcp.__version__.partition(".")[0] != MAJOR:
        raise ConfigError(PepFault.CONFIG_INVALID, f"FastMCP {fastmcp.__version__}: the guard knows version {MAJOR}")
    if server.auth is not None:
        raise ConfigError(PepFault.CONFIG_INVALID, "the server's own auth would refuse every token; leave it out")

    async def within(context: Any, call_next: Any) -> Any:
        """One message: a call goes through the guard, and a list has its caller's tools alone."""
        if context.method == "tools/list":
            listed = await call_next(context)
            if _whole.get():
                return listed
            names = shown(_lister(context), [each.to_mcp_tool() for each in listed])
            return [each for each in listed if each.name in names]
        if context.method != "tools/call":
            return await call_next(context)
        ctx = _context(context, lambda params: call_next(context.copy(message=params)))
        answer = await guard(ctx, context.message)
        if isinstance(answer, InputRequiredResult):
            return InputRequiredToolResult(answer)
        if not isinstance(answer, CallToolResult):
            return answer
        if ctx.told is not None and answer.content is ctx.told.content:
            # The tool's own, with all that the server knows of it.
            return ctx.result.model_copy(update={"meta": answer.meta})
        return ToolResult.from_mcp_result(answer)

    class Told(ServerExtension):
        identifier = extension

        def settings(self) -> dict[str, Any]:
            return dict(settings)

    cast("Any", server).add_extension(Told())
    server.middleware.insert(0, within)


def lowlevel(server: FastMCPServer) -> Server[Any]:
    """The SDK's low-level server behind it.

    Raises:
        ConfigError: another version, which names it otherwise.
    """
    # FastMCP 4 names it nowhere in public before its HTTP app lives, and its middleware sees no raw params.
    low = getattr(server, "_mcp_server", None)
    if not isinstance(low, Server):
        raise ConfigError(PepFault.CONFIG_INVALID, "this version of FastMCP is not known to the guard")
    return low


def app_of(server: FastMCPServer, parts: SplitResult) -> ASGIApp:
    """The server's HTTP app, without sessions: each request stands for itself.

    Args:
        server: a FastMCP server.
        parts: of its canonical URL.
    """
    return server.http_app(
        path=parts.path,
        transport="http",
        stateless_http=True,
        host_origin_protection=True,
        allowed_hosts=[parts.netloc],
        allowed_origins=[f"{parts.scheme}://{parts.netloc}"],
    )


def _lister(context: Any) -> Any:
    """Context of a list, with the credentials of exactly this request."""
    asked = context.fastmcp_context.request_context
    scope = {} if asked is None or asked.request is None else asked.request.scope
    http = scope.get(HTTP_REQUEST)
    proven = http is not None and http.rpc.get("method") == "tools/list"
    return SimpleNamespace(request=SimpleNamespace(scope=scope if proven else {}))


def _context(context: Any, go_on: Callable[[CallToolRequestParams], Awaitable[Any]]) -> _Context:
    """Context for the guard; the credentials in it are those of exactly this call, and are taken out."""
    asked = context.fastmcp_context.request_context
    scope = {} if asked is None or asked.request is None else asked.request.scope
    credentials, http = scope.pop(CREDENTIALS, None), scope.get(HTTP_REQUEST)
    proven = {}
    if credentials is not None and http is not None and http.calls:
        sent, message = http.rpc["params"], context.message
        if (sent.get("name"), sent.get("arguments") or {}) == (message.name, message.arguments or {}):
            proven = {CREDENTIALS: credentials}
    return _Context(
        request=SimpleNamespace(scope=proven),
        session=None if asked is None else asked.session,
        protocol_version="" if asked is None else asked.protocol_version,
        go_on=go_on,
    )

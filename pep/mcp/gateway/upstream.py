"""MCP server behind the gateway: a connection that is kept up, and requests over it.

A process is begun by the command of the configuration alone. No credential of a caller goes on: what a request carries
to the server is built here.
"""

from __future__ import annotations

import asyncio
import os
from contextlib import AsyncExitStack, asynccontextmanager
from contextvars import Context
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar, cast

import httpx2
from mcp import Client, MCPError, StdioServerParameters
from mcp.client.stdio import stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp_types import (
    CONNECTION_CLOSED,
    METHOD_NOT_FOUND,
    REQUEST_TIMEOUT,
    CallToolRequestParams,
    JSONRPCRequest,
    PaginatedRequestParams,
)
from pydantic import ValidationError

from pep.base.errors import UpstreamError
from pep.mcp.gateway.server_changes import ServerChanges
from pep.mcp.passed_task import PassedTasks

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Mapping

    from mcp.client.session import ClientSession, MessageHandlerFnT
    from mcp.shared.dispatcher import ProgressFnT
    from mcp.shared.message import SessionMessage
    from mcp_types import (
        CallToolResult,
        GetPromptRequestParams,
        GetPromptResult,
        Implementation,
        InputRequiredResult,
        Prompt,
        ReadResourceRequestParams,
        ReadResourceResult,
        Resource,
        ResourceTemplate,
        Tool,
    )

    from pep.mcp.gateway.upstream_config import UpstreamConfig
    from pep.mcp.passed_task import PassedTask

    T = TypeVar("T")

CONNECT_S: Final = 10.0
"""Ours: longest wait for a connection to be there."""
START_S: Final = 60.0
"""Ours: longest start of a process: a package runner may have to fetch the server first."""
AGAIN_S: Final = (0.1, 0.5, 2.0, 5.0)
"""Ours: waits before the next attempts to connect; the last one repeats, and requests no longer wait meanwhile."""
PAGES: Final = 100
"""Ours: most pages of one list; a server that never ends its list is refused."""
STREAM_S: Final = 600.0
"""Ours: longest silence of a stream."""
NAMES: Final = 10_000
"""Ours: most members of one list."""
CAPABILITIES: Final = "io.modelcontextprotocol/clientCapabilities"
"""Key of `_meta` under which a request states what its client can do (MCP 2026-07-28)."""
DECLARED: Final = "dev.ztpm/declared"
"""Key of `_meta` under which the caller's own statement of that goes as far as the transport."""
SESSION_OVER: Final = "Session terminated"
"""Word of the SDK for a session that the server does not know any more."""


@dataclass(frozen=True, slots=True)
class SoleCaller:
    """Client of the protocol before 2026-07-28 for whom alone a connection is.

    Attributes:
        declared: abilities that the server is told of.
        answers: callbacks of the SDK's client, by their names there.
        connected: is awaited after each connection, before anything else goes over it.
        noticed: is told of each message that the server sends on its own.
    """

    declared: Mapping[str, Any]
    answers: Mapping[str, Any]
    connected: Callable[[ClientSession], Awaitable[None]]
    noticed: MessageHandlerFnT


class ToolUpstream:
    """One server, under its name in the configuration.

    Args:
        config: of it.
        changed: is told of each new state in words, as it comes.
        auth: signs each request to a URL; None for the configured bearer token, or for nothing.
        caller: for whom alone the connection is; None: it is everybody's, and nobody can be asked over it.

    Attributes:
        config: the same.
        changes: of the server's lists and resources, for all who listen to them.
        CONNECTED: word for the state in which it answers.
    """

    CONNECTED: Final = "connected"

    def __init__(
        self,
        config: UpstreamConfig,
        changed: Callable[[str], None],
        *,
        auth: httpx2.Auth | None = None,
        caller: SoleCaller | None = None,
    ) -> None:
        self.config = config
        self.changes = ServerChanges(self.session, self.lost)
        self._auth = auth
        self._caller = caller
        self._others = 0
        self._changed = changed
        self._state = ""
        self._client: Client | None = None
        self._settled = asyncio.Event()
        """No request waits: it answers, or it has not come back for a while."""
        self._broken = asyncio.Event()
        self._tried = asyncio.Event()

    async def run(self) -> None:
        """Keeps the connection up, until it is cancelled."""
        tries = 0
        mode = "auto" if self._caller is None else "legacy"
        while True:
            try:
                async with self._connected(mode) as client:
                    tries = 0
                    if self._caller is not None:
                        await self._caller.connected(client.session)
                    self._client = client
                    self._broken.clear()
                    self._settled.set()
                    self._tried.set()
                    self._told(self.CONNECTED)
                    await self._broken.wait()
                    self._told("the connection ended")
            except Exception as error:  # noqa: BLE001 - whatever a foreign server does: it is connected to again
                self._told(f"not connected: {_words(error)}")
                # Some servers end at a question of the newer protocol; the next attempt is in the older one.
                if self._caller is None:
                    mode = "auto" if mode == "legacy" or self.config.url else "legacy"
                if self._caller is not None or mode == "auto":
                    self._tried.set()
            finally:
                self._client = None
                self._settled.clear()
            last = len(AGAIN_S) - 1
            if tries >= last:
                self._settled.set()
            await asyncio.sleep(AGAIN_S[min(tries, last)])
            tries += 1

    def _told(self, words: str) -> None:
        """Tells a state that is another one than the last."""
        if words != self._state:
            self._state = words
            self._changed(words)

    async def tried(self) -> None:
        """Waits for the first connection, or for a failure in each protocol that the server may speak."""
        await self._tried.wait()

    @property
    def is_connected(self) -> bool:
        """True while it can be asked."""
        return self._client is not None

    async def lost(self) -> None:
        """Waits for the end of the connection that there is."""
        await self._broken.wait()

    @asynccontextmanager
    async def alone(self, caller: SoleCaller) -> AsyncIterator[ToolUpstream | None]:
        """Connection to the same server for one caller; None where there is none for it.

        Args:
            caller: for whom it is.
        """
        if self._others >= self.config.most_sessions:
            yield None
            return
        self._others += 1
        made = ToolUpstream(self.config, lambda _: None, auth=self._auth, caller=caller)
        running = asyncio.create_task(made.run(), context=Context())
        try:
            await made.tried()
            if not made.is_connected:
                running.cancel()
            yield made if made.is_connected else None
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
            self._others -= 1

    @asynccontextmanager
    async def _connected(self, mode: str) -> AsyncIterator[Client]:
        config = self.config
        async with AsyncExitStack() as stack:
            if config.url:
                if config.bearer and not os.environ.get(config.bearer):
                    raise UpstreamError(config.name, f"the environment variable {config.bearer} is not set")
                headers = {"authorization": f"Bearer {os.environ[config.bearer]}"} if config.bearer else {}
                # A call has a limit of its own; a stream of what the server tells on its own may be silent for longer.
                read_s = max(config.timeout_s, STREAM_S)
                http = httpx2.AsyncClient(
                    headers=headers, auth=self._auth, timeout=httpx2.Timeout(CONNECT_S, read=read_s)
                )
                await stack.enter_async_context(http)
                transport = streamable_http_client(config.url, http_client=http)
            else:
                command, *arguments = config.command
                environment = {name: os.environ[name] for name in config.environment if name in os.environ}
                parameters = StdioServerParameters(
                    command=command,
                    args=arguments,
                    env=environment,
                    cwd=config.folder,
                    encoding_error_handler="replace",
                )
                transport = stdio_client(parameters)
            answers: Mapping[str, Any] = {} if self._caller is None else self._caller.answers
            client = Client(
                _declaring(transport, None if self._caller is None else self._caller.declared),
                cache=None,
                mode=mode,
                read_timeout_seconds=config.timeout_s,
                message_handler=self.changes.noticed if self._caller is None else self._caller.noticed,
                **answers,
                extensions=[PassedTasks()],
            )
            async with asyncio.timeout(CONNECT_S if config.url else START_S):
                await stack.enter_async_context(client)
            yield client

    # ---- requests

    @property
    def about(self) -> tuple[Implementation | None, str | None]:
        """The server's name and version, and its instructions; nothing while it is not connected."""
        client = self._client
        return (None, None) if client is None else (client.server_info, client.instructions)

    async def tools(self) -> list[Tool]:
        """Definitions of its tools as it lists them now.

        Raises:
            UpstreamError: it does not answer, or its list has no end.
        """
        return await self._listed("tools", lambda session, page: session.list_tools(params=page))

    async def prompts(self) -> list[Prompt]:
        """Its prompts, likewise; none where it has none."""
        if self._lacks("prompts"):
            return []
        return await self._listed("prompts", lambda session, page: session.list_prompts(params=page))

    async def resource_templates(self) -> list[ResourceTemplate]:
        """Templates of its resources, likewise."""
        if self._lacks("resources"):
            return []
        return await self._listed(
            "resource_templates", lambda session, page: session.list_resource_templates(params=page)
        )

    async def resources(self) -> list[Resource]:
        """Its resources, likewise."""
        if self._lacks("resources"):
            return []
        return await self._listed("resources", lambda session, page: session.list_resources(params=page))

    async def asked(self, question: Callable[[ClientSession], Awaitable[T]]) -> T:
        """Answer to a question without an effect; asked again over a new connection where one has ended.

        Raises:
            UpstreamError: it does not answer.
            MCPError: it refuses.
        """
        try:
            return await self._sent(question)
        except UpstreamError:
            return await self._sent(question)

    async def call(
        self, params: CallToolRequestParams, *, meta: dict[str, Any], progress: ProgressFnT | None
    ) -> CallToolResult | InputRequiredResult | PassedTask:
        """Result of a call, sent once and at once.

        It was decided for this moment, so it waits for no connection.

        Args:
            params: name of the tool here, decided arguments, and a caller's answers to the server's own questions.
            meta: of the request.
            progress: is told of the server's progress.

        Raises:
            UpstreamError: it does not answer; whether it did anything is not known.
            MCPError: it refuses.
        """
        if not self.is_connected:
            raise UpstreamError(self.config.name, "not connected")
        return await self._sent(
            lambda session: cast("Any", session).call_tool(
                params.name,
                params.arguments,
                progress_callback=progress,
                input_responses=params.input_responses,
                request_state=params.request_state,
                meta=meta or None,
                allow_input_required=True,
                allow_claimed=True,
            )
        )

    async def prompt(
        self, params: GetPromptRequestParams, *, meta: dict[str, Any]
    ) -> GetPromptResult | InputRequiredResult:
        """The prompt of that name here, as `asked`."""
        return await self.asked(
            lambda session: session.get_prompt(
                params.name,
                params.arguments,
                input_responses=params.input_responses,
                request_state=params.request_state,
                meta=meta or None,  # type: ignore[arg-type]
                allow_input_required=True,
            )
        )

    async def resource(
        self, params: ReadResourceRequestParams, *, meta: dict[str, Any]
    ) -> ReadResourceResult | InputRequiredResult:
        """The resource at that address, likewise."""
        return await self.asked(
            lambda session: session.read_resource(
                params.uri,
                input_responses=params.input_responses,
                request_state=params.request_state,
                meta=meta or None,  # type: ignore[arg-type]
                allow_input_required=True,
            )
        )

    async def once(self, question: Callable[[ClientSession], Awaitable[T]]) -> T:
        """Answer to a question that may have an effect, sent once.

        Raises:
            UpstreamError: it does not answer; whether it did anything is not known.
            MCPError: it refuses.
        """
        return await self._sent(question)

    def _lacks(self, capability: str) -> bool:
        client = self._client
        return client is None or getattr(client.server_capabilities, capability) is None

    async def _listed(
        self, what: str, page: Callable[[ClientSession, PaginatedRequestParams], Awaitable[Any]]
    ) -> list[Any]:
        found: list[Any] = []
        cursor: str | None = None
        for _ in range(PAGES):
            at = PaginatedRequestParams(cursor=cursor)
            try:
                listed = await self.asked(lambda session, at=at: page(session, at))  # type: ignore[misc]
            except MCPError as error:
                if error.code == METHOD_NOT_FOUND:  # also where the server says that it has some
                    return []
                raise UpstreamError(self.config.name, f"its list of {what} is refused: {error.code}") from error
            except (ValidationError, RuntimeError) as error:
                raise UpstreamError(self.config.name, f"its list of {what} is none: {_words(error)}") from error
            found.extend(getattr(listed, what))
            cursor = listed.next_cursor
            if len(found) > NAMES:
                break
            if cursor is None:
                return found
        raise UpstreamError(self.config.name, f"its list of {what} is longer than {NAMES}")

    async def session(self) -> ClientSession:
        """The connection's session; waits for a connection.

        Raises:
            UpstreamError: there is none.
        """
        return (await self._connection()).session

    async def _connection(self) -> Client:
        try:
            async with asyncio.timeout(CONNECT_S):
                await self._settled.wait()
        except TimeoutError:
            raise UpstreamError(self.config.name, "not connected") from None
        client = self._client
        if client is None:
            raise UpstreamError(self.config.name, "not connected")
        return client

    async def _sent(self, question: Callable[[ClientSession], Awaitable[T]]) -> T:
        client = await self._connection()
        try:
            return await question(client.session)
        except MCPError as error:
            over = error.code == CONNECTION_CLOSED or error.message == SESSION_OVER
            if over:
                self._end(client)
            if over or error.code == REQUEST_TIMEOUT:
                raise UpstreamError(
                    self.config.name, "the connection ended" if over else "no answer in time"
                ) from error
            raise
        except (OSError, httpx2.HTTPError) as error:
            self._end(client)
            raise UpstreamError(self.config.name, _words(error)) from error

    def _end(self, client: Client) -> None:
        """Ends the connection that failed, unless another has taken its place."""
        if self._client is client:
            self._settled.clear()
            self._broken.set()


def _words(error: BaseException) -> str:
    """Kind of the first error within, with the system's words about it; of one of ours the detail."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    if isinstance(error, UpstreamError):
        return error.detail
    said = error.strerror if isinstance(error, OSError) else ""
    return f"{type(error).__name__}: {said}" if said else type(error).__name__


class _Declaring:
    """Write stream that states the caller's abilities in place of this client's own.

    Args:
        stream: the transport's.
        declared: abilities of the one caller; None where each request carries those of its own.
    """

    def __init__(self, stream: Any, declared: Mapping[str, Any] | None) -> None:
        self._stream = stream
        self._declared = declared

    async def send(self, message: SessionMessage) -> None:
        request = message.message
        if isinstance(request, JSONRPCRequest) and request.params is not None:
            if request.method == "initialize":
                request.params["capabilities"] = dict(self._declared or {})
            meta = request.params.get("_meta")
            if isinstance(meta, dict) and DECLARED in meta:
                declared = meta.pop(DECLARED)
                if CAPABILITIES in meta:  # else the server is of the era that heard them once, from this client
                    meta[CAPABILITIES] = declared
        await self._stream.send(message)

    async def aclose(self) -> None:
        await self._stream.aclose()

    async def __aenter__(self) -> Self:
        await self._stream.__aenter__()
        return self

    async def __aexit__(self, *raised: object) -> None:
        await self._stream.__aexit__(*raised)


@asynccontextmanager
async def _declaring(transport: Any, declared: Mapping[str, Any] | None) -> AsyncIterator[Any]:
    """The transport, whose requests state their callers' abilities."""
    async with transport as (read, write):
        yield read, _Declaring(write, declared)

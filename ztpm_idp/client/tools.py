"""Tools of an MCP server, called with an agent's authority through the SDK's own client."""

from __future__ import annotations

import secrets
import time
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Self

import anyio
import httpx2
from mcp import Client, MCPError, stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp_types import CONNECTION_CLOSED, JSONRPCRequest

from capabilities import tracing
from capabilities.values import trace_context
from ztpm_idp.client import direct_http
from ztpm_idp.client.caller import TIMEOUT_S, ClientError
from ztpm_idp.client.denials import DECISION_META, REFUSED_CODE, Deferred, Denied, error_of

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping
    from contextlib import AbstractAsyncContextManager
    from types import TracebackType

    from mcp import StdioServerParameters
    from mcp.shared.message import SessionMessage
    from mcp_types import CallToolResult, Tool

    from ztpm_idp.client.renewal import Renewal
    from ztpm_idp.client.signing import MetaAuth

    Command = StdioServerParameters
    Transport = AbstractAsyncContextManager[tuple[Any, Any]]

CALL_S: Final = 600.0
"""Ours: longest wait for the answer to a call, which may be a motion's end."""
_RETRY_S: Final = 5.0
"""Longest pause between two looks at a deferred call."""


class Tools:
    """An open connection to one server: every request of it is signed and presents the token.

    Args:
        url: of the server, canonical: the audience of the token.
        auth: signs each request over HTTP.
        patience_s: so long a deferred call waits for people before it raises `Deferred`.
        asked: told the page at which people answer, once for each deferred call.
        clock: monotonic, seconds.
        renewal: of the tokens that `auth` presents; None for a single token.

    Raises:
        Denied: on entering: the server refused the token.
        ClientError: `UNREACHABLE`: no server answers there.
    """

    def __init__(
        self,
        url: str,
        auth: httpx2.Auth | None,
        *,
        patience_s: float = 0.0,
        asked: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
        renewal: Renewal | None = None,
    ) -> None:
        self.url = url
        self._auth = auth
        self._patience_s = patience_s
        self._asked = asked
        self._clock = clock
        self._renewal = renewal
        self._open = AsyncExitStack()
        self._client: Client | None = None

    async def __aenter__(self) -> Self:
        await self._renewed()
        async with AsyncExitStack() as opening:
            transport = await self._transport(opening)
            try:
                self._client = await opening.enter_async_context(Client(transport))
            except Exception as error:
                raise self._told(error) from error
            self._open = opening.pop_all()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client = None
        await self._open.aclose()

    async def _transport(self, opening: AsyncExitStack) -> Transport:
        http = await opening.enter_async_context(direct_http.async_client())
        http.auth, http.timeout = self._auth or httpx2.Auth(), httpx2.Timeout(TIMEOUT_S, read=CALL_S)
        return streamable_http_client(self.url, http_client=http)

    async def list(self) -> list[Tool]:
        """The tools that the server shows to this token.

        Raises:
            Denied, ClientError: as `call`.
        """
        found: list[Tool] = []
        cursor: str | None = None
        while True:
            await self._renewed()
            try:
                page = await self._connected().list_tools(cursor=cursor)
            except Exception as error:
                raise self._told(error) from error
            found += page.tools
            cursor = page.next_cursor
            if cursor is None:
                return found

    async def call(self, tool: str, arguments: Mapping[str, object] | None = None) -> CallToolResult:
        """Result of a permitted call; `is_error` in it is the tool's own.

        Args:
            tool: name of it.
            arguments: of the call; a retry has exactly the same.

        Raises:
            Denied: nothing has happened.
            Deferred: people were asked, and have not answered within `patience_s`.
            ClientError: `UNREACHABLE` or `ANSWER_MALFORMED`: whether it has happened is not known.
        """
        # One trace for the call, however often it is tried again while people are asked.
        with tracing.begun(trace_context.CALL, random=secrets.token_bytes):
            return await self._tried(tool, dict(arguments or {}))

    async def _tried(self, tool: str, given: dict[str, Any]) -> CallToolResult:
        begun, told = self._clock(), False
        while True:
            try:
                return await self._once(tool, given)
            except Deferred as deferred:
                if not told and self._asked is not None:
                    self._asked(deferred.page)
                told = True
                pause_s = min(float(deferred.retry_after_s), _RETRY_S)
                if self._clock() + pause_s - begun > self._patience_s:
                    raise
            await anyio.sleep(pause_s)

    async def _renewed(self) -> None:
        """Draws the next token when it is time; within a request a refusal would be told as an outage.

        Raises:
            Denied, ClientError: as `Renewal.token`.
        """
        if self._renewal is not None:
            await anyio.to_thread.run_sync(self._renewal.token)

    async def _once(self, tool: str, arguments: dict[str, Any]) -> CallToolResult:
        await self._renewed()
        try:
            result = await self._connected().call_tool(tool, arguments)
        except Exception as error:
            raise self._told(error) from error
        refused = error_of((result.meta or {}).get(DECISION_META))
        if refused is not None and result.is_error:
            raise refused
        return result

    def _connected(self) -> Client:
        if self._client is None:
            raise RuntimeError("`async with` opens the connection first")
        return self._client

    def _told(self, error: Exception) -> Exception:
        """The error in the words of this client; the SDK wraps the ones of its transport in groups."""
        for each in _inside(error):
            match each:
                case MCPError(code=code, message=reason) if code == REFUSED_CODE:
                    return Denied(reason, {"decision": "DENY", "reason": reason})
                case httpx2.HTTPError() | OSError():
                    return ClientError("UNREACHABLE", 0, f"{self.url}: {type(each).__name__}")
                case MCPError(code=code) if code == CONNECTION_CLOSED:
                    return ClientError("UNREACHABLE", 0, f"{self.url}: the connection was closed")
                case MCPError(message=said):
                    return ClientError("ANSWER_MALFORMED", 0, f"{self.url}: {said}")
        return error


class StdioTools(Tools):
    """An open connection over stdio to a server that is started for it.

    Args:
        command: starts the server.
        auth: signs each request.
        audience: canonical URL of the server: the audience of the token.
        patience_s, asked, clock, renewal: as for `Tools`.
    """

    def __init__(
        self,
        command: Command,
        auth: MetaAuth,
        *,
        audience: str,
        patience_s: float = 0.0,
        asked: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
        renewal: Renewal | None = None,
    ) -> None:
        super().__init__(audience, None, patience_s=patience_s, asked=asked, clock=clock, renewal=renewal)
        self._command = command
        self._meta_auth = auth

    async def _transport(self, opening: AsyncExitStack) -> Transport:  # noqa: ARG002  nothing else is to be closed
        return signed(stdio_client(self._command), self._meta_auth)


@asynccontextmanager
async def signed(transport: Transport, auth: MetaAuth) -> AsyncIterator[tuple[Any, Any]]:
    """A transport of any client of the SDK, on which each request is signed.

    A retry of the client's own, such as after an elicitation, passes here again, and so has a proof of its own. A
    server that is started for the client refuses what was signed before it stood: with a pinned protocol version the
    client awaits `session.discover()` first.

    Args:
        transport: such as `mcp.stdio_client(...)`.
        auth: signs.
    """
    async with transport as (received, sent):
        yield received, _Signed(sent, auth)


class _Signed:
    """Stream of a client's messages, each request signed last of all."""

    def __init__(self, inner: Any, auth: MetaAuth) -> None:
        self._inner = inner
        self._auth = auth

    async def send(self, item: SessionMessage) -> None:
        """Sends one message."""
        message = item.message
        if isinstance(message, JSONRPCRequest):
            params = self._auth.signed(message.method, message.params or {})
            item = replace(item, message=message.model_copy(update={"params": params}))
        await self._inner.send(item)

    async def aclose(self) -> None:
        """No more is sent."""
        await self._inner.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()


def _inside(error: BaseException) -> list[BaseException]:
    """The error and those that it holds."""
    if isinstance(error, BaseExceptionGroup):
        return [each for held in error.exceptions for each in _inside(held)]
    return [error]

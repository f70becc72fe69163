"""List of the tools of an MCP server, read by an ordinary client within bounds of time, size and number."""

from __future__ import annotations

import logging
import tempfile
from contextlib import AsyncExitStack
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

import anyio
import httpx2
from mcp import Client, MCPError, StdioServerParameters
from mcp.client.stdio import stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp_types import CONNECTION_CLOSED
from pydantic import ValidationError

from capabilities.values.characters import shown
from ztpm_idp.client import direct_http

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence
    from typing import TextIO

    from mcp_types import Tool

TOOLS: Final = 512
"""Ours: most tools of a list; no person reviews more."""
PAGES: Final = 128
"""Ours: most pages of a list."""
LIST_BYTES: Final = 4_194_304
"""Ours: most bytes of a list, and of all that a server over HTTP says."""
SAID_CHARACTERS: Final = 200
"""Characters of foreign words that are told."""
SAID_BYTES: Final = 4_096
"""Last bytes that a process wrote to its standard error, in which its last word is looked for."""


class ToolListCode(StrEnum):
    """Codes of a list that could not be read."""

    SERVER_UNREACHABLE = "SERVER_UNREACHABLE"
    SERVER_MALFORMED = "SERVER_MALFORMED"
    TOOL_LIST_TOO_LARGE = "TOOL_LIST_TOO_LARGE"
    NO_TOOLS = "NO_TOOLS"
    TOOL_TWICE = "TOOL_TWICE"


class ToolListError(Exception):
    """A list that could not be read.

    Attributes:
        code: why.
        detail: place and cause.
        ended: True where the server closed the connection.
    """

    def __init__(self, code: ToolListCode, detail: str, *, ended: bool = False) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail
        self.ended = ended


@dataclass(frozen=True, slots=True)
class ToolList:
    """Tools of a server, each name once, and what the server calls itself."""

    server: str
    version: str
    tools: tuple[Tool, ...]


async def tools_at(url: str, *, wait_s: float) -> ToolList:
    """The tools that a server over HTTP lists to a client without credentials.

    Args:
        url: of its MCP endpoint.
        wait_s: longest wait for the whole list.

    Raises:
        ToolListError: with the reason.
    """
    async with AsyncExitStack() as opening:
        http = await opening.enter_async_context(direct_http.async_client())
        http.timeout = httpx2.Timeout(wait_s)
        http.event_hooks = {"response": [_Allowance().bounded]}
        client = Client(streamable_http_client(url, http_client=http), cache=None)
        return await _listed(client, url, wait_s)


async def tools_of_command(command: Sequence[str], *, environment: dict[str, str], wait_s: float) -> ToolList:
    """The tools that a server over its standard input and output lists; it is started, and ended again.

    Args:
        command: the person's own, with its arguments.
        environment: variables that it gets beside PATH, HOME and the like.
        wait_s: longest wait for the whole list.

    Raises:
        ToolListError: with the reason, and the last that the process said.
    """
    name = shown(command[0])
    server = StdioServerParameters(command=command[0], args=list(command[1:]), env=environment)
    with tempfile.TemporaryFile("w+", errors="replace") as errors:
        try:
            try:
                return await _listed(Client(stdio_client(server, errlog=errors), cache=None), name, wait_s)
            except ToolListError as error:
                if not error.ended:
                    raise
            # Servers of early releases of the SDK (1.6) end at the question which protocol they speak.
            return await _listed(Client(stdio_client(server, errlog=errors), cache=None, mode="legacy"), name, wait_s)
        except ToolListError as error:
            said = _last_said(errors)
            raise ToolListError(error.code, f"{error.detail}; it said: {said}" if said else error.detail) from error


async def _listed(client: Client, place: str, wait_s: float) -> ToolList:
    # What the SDK logs of a server that speaks no MCP is told by its code.
    sdk = logging.getLogger("mcp")
    level = sdk.level
    sdk.setLevel(logging.CRITICAL + 1)
    try:
        with anyio.fail_after(wait_s):
            async with client:
                named = client.server_info
                name, version = ("", "") if named is None else (named.name, named.version)
                return ToolList(name, version, checked(await _pages(client)))
    except Exception as error:
        raise _told(error, place, wait_s) from error
    finally:
        sdk.setLevel(level)


async def _pages(client: Client) -> list[Tool]:
    found: list[Tool] = []
    seen: set[str | None] = set()
    cursor: str | None = None
    size = 0
    while cursor not in seen:
        seen.add(cursor)
        page = await client.list_tools(cursor=cursor)
        found += page.tools
        size += sum(len(tool.model_dump_json()) for tool in page.tools)
        if len(found) > TOOLS or size > LIST_BYTES or len(seen) > PAGES:
            what = f"more than {TOOLS} tools, {LIST_BYTES} bytes or {PAGES} pages"
            raise ToolListError(ToolListCode.TOOL_LIST_TOO_LARGE, what)
        cursor = page.next_cursor
        if cursor is None:
            return found
    raise ToolListError(ToolListCode.SERVER_MALFORMED, "its list of tools comes back to a page that was read")


def checked(tools: Sequence[Tool]) -> tuple[Tool, ...]:
    """The tools, each name once and one at least.

    Raises:
        ToolListError: `NO_TOOLS` or `TOOL_TWICE`.
    """
    if not tools:
        raise ToolListError(ToolListCode.NO_TOOLS, "its list is empty")
    names = [tool.name for tool in tools]
    if twice := next((name for at, name in enumerate(names) if name in names[:at]), None):
        raise ToolListError(ToolListCode.TOOL_TWICE, f"the server lists two tools of the name {shown(twice)!r}")
    return tuple(tools)


# --- what went wrong -------------------------------------------------------------------------------------------------


def _told(error: BaseException, place: str, wait_s: float) -> ToolListError:
    """The error with its code; the SDK wraps those of its transport in groups."""
    every = _inside(error)
    for each in every:
        if isinstance(each, ToolListError):
            return each
    for each in every:
        match each:
            case httpx2.HTTPStatusError(response=response):
                return ToolListError(
                    ToolListCode.SERVER_UNREACHABLE, f"{place}: it answers with HTTP {response.status_code}"
                )
            case TimeoutError() | httpx2.TimeoutException():
                return ToolListError(
                    ToolListCode.SERVER_UNREACHABLE, f"{place}: no list within {wait_s:g} seconds (--wait)"
                )
            case httpx2.HTTPError() | OSError():
                why = shown(str(each))[:SAID_CHARACTERS] or type(each).__name__
                return ToolListError(ToolListCode.SERVER_UNREACHABLE, f"{place}: {why}")
            case MCPError(code=code) if code == CONNECTION_CLOSED:
                return ToolListError(
                    ToolListCode.SERVER_UNREACHABLE, f"{place}: it ended before it gave a list", ended=True
                )
            case MCPError(message=said):
                return ToolListError(ToolListCode.SERVER_MALFORMED, f"{place}: {shown(said)[:SAID_CHARACTERS]}")
            case ValidationError():
                first = each.errors(include_url=False)[0]
                where = shown(".".join(map(str, first["loc"])))
                return ToolListError(
                    ToolListCode.SERVER_MALFORMED, f"{place}: {where}: {shown(first['msg'])}"[:SAID_CHARACTERS]
                )
            case _:
                pass
    return ToolListError(ToolListCode.SERVER_MALFORMED, f"{place}: {shown(repr(error))[:SAID_CHARACTERS]}")


def _inside(error: BaseException) -> list[BaseException]:
    """The error and those that it holds."""
    if isinstance(error, BaseExceptionGroup):
        return [each for held in error.exceptions for each in _inside(held)]
    return [error]


def _last_said(errors: TextIO) -> str:
    """The last line of a process's standard error, safe for a terminal."""
    size = errors.seek(0, 2)
    errors.seek(max(0, size - SAID_BYTES))
    lines = [line.strip() for line in errors.read().splitlines() if any(map(str.isalnum, line))]
    return shown(lines[-1])[:SAID_CHARACTERS] if lines else ""


class _Allowance:
    """Bytes that a server over HTTP may still say."""

    def __init__(self) -> None:
        self.left = LIST_BYTES

    async def bounded(self, response: httpx2.Response) -> None:
        """Lets the body of an answer count, also while it comes."""
        if isinstance(response.stream, httpx2.AsyncByteStream):
            response.stream = _BoundedStream(response.stream, self)


class _BoundedStream(httpx2.AsyncByteStream):
    """Body of an answer that ends in an error once too much was said."""

    def __init__(self, inner: httpx2.AsyncByteStream, allowance: _Allowance) -> None:
        self._inner = inner
        self._allowance = allowance

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for chunk in self._inner:
            self._allowance.left -= len(chunk)
            if self._allowance.left < 0:
                raise ToolListError(ToolListCode.TOOL_LIST_TOO_LARGE, f"more than {LIST_BYTES} bytes")
            yield chunk

    async def aclose(self) -> None:
        await self._inner.aclose()

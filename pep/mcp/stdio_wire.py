"""MCP over this process's stdin and stdout: each line is screened first, and nothing else is written.

The SDK's transport parses lines by itself, and has no public hook before that; so lines are read here, by the strict
reader that HTTP has, and only what it made of them goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import os
import threading
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any, Final

import anyio
from mcp.server.stdio import stdio_server
from mcp.shared.message import SessionMessage
from mcp_types import ErrorData, JSONRPCError, jsonrpc_message_adapter
from pydantic import ValidationError

from pep.mcp.body_screen import LINE_BYTES, Unfit, screen
from pep.mcp.http_request import REFUSED_CODE, digest
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

    from anyio.abc import ObjectSendStream
    from mcp.server.lowlevel.server import Server

    from pep.mcp.http_request import Refusals

STDIN: Final = 0
BAD_REQUEST: Final = 400
"""Status on record, the one that HTTP would have told."""


class StdioWire:
    """The claimed streams of this process.

    Args:
        stdin: descriptor of the lines.
        sent: takes messages for stdout.
    """

    def __init__(self, stdin: int, sent: Any) -> None:
        self._stdin = stdin
        self._sent = sent

    async def serve(self, server: Server[Any], refusals: Refusals) -> None:
        """Serves one client until stdin ends.

        Args:
            server: guarded.
            refusals: of lines.
        """
        feed, taken = anyio.create_memory_object_stream[SessionMessage | Exception](0)
        loop, ended = asyncio.get_running_loop(), asyncio.Event()

        async def take(line: bytes) -> None:
            await self._take(line, feed, refusals)

        def read() -> None:
            # The loop has gone where the server ended first.
            with contextlib.suppress(RuntimeError, asyncio.CancelledError):
                for line in lines_of(self._stdin):
                    asyncio.run_coroutine_threadsafe(take(line), loop).result()
                loop.call_soon_threadsafe(ended.set)

        async def end() -> None:
            await ended.wait()
            await feed.aclose()

        # A thread that waits for a line must not keep the process from ending.
        threading.Thread(target=read, name="stdin", daemon=True).start()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(end)
            await server.run(taken, self._sent.clone(), server.create_initialization_options())
            tasks.cancel_scope.cancel()

    async def _take(self, line: bytes, feed: ObjectSendStream[SessionMessage | Exception], refusals: Refusals) -> None:
        """Passes a fit line on; any other is refused, and the next one read."""
        if not line.strip():
            return
        found = screen(line, limit_bytes=LINE_BYTES)
        if not isinstance(found, Unfit):
            try:
                message = jsonrpc_message_adapter.validate_python(found, by_name=False)
            except ValidationError:
                found = Unfit(Reason.BODY_MALFORMED, "no message of JSON-RPC")
            else:
                with contextlib.suppress(anyio.BrokenResourceError, anyio.ClosedResourceError):
                    await feed.send(SessionMessage(message))
                return
        where = {"method": "stdio", "body": digest(line), "detail": found.detail}
        await refusals.record(BAD_REQUEST, found.reason, credentials=None, where=where)
        # Nothing in the line is believed, so the answer has no id (JSON-RPC 2.0, section 5).
        error = JSONRPCError(jsonrpc="2.0", id=None, error=ErrorData(code=REFUSED_CODE, message=str(found.reason)))
        await self._sent.send(SessionMessage(error))


@asynccontextmanager
async def claimed() -> AsyncIterator[StdioWire]:
    """Stdin and stdout are the protocol's inside: what else reads finds nothing, what else writes goes to stderr."""
    stdin = os.dup(STDIN)
    try:
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, STDIN)
        os.close(nothing)
        # Of the SDK's transport the half that writes: what it reads is empty.
        async with stdio_server(stdin=anyio.wrap_file(io.StringIO())) as (unread, sent):
            await unread.aclose()
            try:
                yield StdioWire(stdin, sent)
            finally:
                await sent.aclose()
    finally:
        # The copy stays open: a thread may wait on it still.
        os.dup2(stdin, STDIN)


def lines_of(descriptor: int) -> Iterator[bytes]:
    """Lines without their ends; of one that is too long only so much that it is seen to be."""
    rest, skipped = b"", False
    while chunk := os.read(descriptor, LINE_BYTES):
        *whole, rest = (rest + chunk).split(b"\n")
        for line in whole:
            if not skipped:
                yield line
            skipped = False
        if len(rest) > LINE_BYTES:
            if not skipped:
                yield rest
            rest, skipped = b"", True
    if not skipped:
        yield rest

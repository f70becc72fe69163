"""MCP over this process's stdin and stdout: each line is screened first, and nothing else is written.

The SDK's transport parses lines by itself, and has no public hook before that; so lines are read here, by the strict
reader that HTTP has, and only what it made of them goes on. It reads and writes in threads, three turns of which a call
waits for; here the event loop does both where nothing makes it wait.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
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

STDIN, STDOUT, STDERR = 0, 1, 2
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

        async def read() -> None:
            async with feed:
                async for line in lines_of(self._stdin):
                    await self._take(line, feed, refusals)

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(read)
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


class StdoutText:
    """Standard output as the SDK's transport writes to it.

    Args:
        descriptor: of the stream.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._room = select.poll()
        self._room.register(descriptor, select.POLLOUT)
        self._unsent = b""

    async def write(self, text: str) -> None:
        """Takes in text for the next `flush`."""
        self._unsent += text.encode()

    async def flush(self) -> None:
        """Writes what there is: at once where the stream has room for it, else in a thread.

        Raises:
            OSError: the reader has gone.
        """
        unsent, self._unsent = memoryview(self._unsent), b""
        while unsent and self._room.poll(0):
            # A stream with room for anything has it for a page, which PIPE_BUF is (pipe(7)).
            unsent = unsent[os.write(self._descriptor, unsent[: select.PIPE_BUF]) :]
        if unsent:
            await anyio.to_thread.run_sync(self._write, unsent, abandon_on_cancel=True)

    def _write(self, unsent: memoryview) -> None:
        while unsent:
            unsent = unsent[os.write(self._descriptor, unsent) :]


@asynccontextmanager
async def claimed() -> AsyncIterator[StdioWire]:
    """Stdin and stdout are the protocol's inside: what else reads finds nothing, what else writes goes to stderr."""
    with _moved(STDIN, os.open(os.devnull, os.O_RDONLY)) as stdin, _moved(STDOUT, _stderr()) as stdout:
        # Of the SDK's transport the half that writes: what it reads is empty.
        unused: Any = anyio.wrap_file(io.StringIO())
        written: Any = StdoutText(stdout)
        async with stdio_server(stdin=unused, stdout=written) as (unread, sent):
            await unread.aclose()
            try:
                yield StdioWire(stdin, sent)
            finally:
                await sent.aclose()


def _stderr() -> int:
    """Another descriptor of standard error; of nothing where that is closed."""
    try:
        return os.dup(STDERR)
    except OSError:
        return os.open(os.devnull, os.O_WRONLY)


@contextlib.contextmanager
def _moved(stream: int, instead: int) -> Iterator[int]:
    """A descriptor of the stream, in whose place `instead` is inside."""
    own = os.dup(stream)
    os.dup2(instead, stream)
    os.close(instead)
    try:
        yield own
    finally:
        os.dup2(own, stream)  # its copy stays open: a thread may write to it still


async def lines_of(descriptor: int) -> AsyncIterator[bytes]:
    """Lines without their ends; of one that is too long only so much that it is seen to be."""
    rest, skipped = b"", False
    while chunk := await _read(descriptor):
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


async def _read(descriptor: int) -> bytes:
    """Bytes of the stream as they come; none at its end."""
    with contextlib.suppress(PermissionError):  # a file: it makes nobody wait
        await anyio.wait_readable(descriptor)
    return os.read(descriptor, LINE_BYTES)

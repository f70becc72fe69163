"""Bridge: a server over stdio, for clients that know nothing else, to one over HTTP whose requests are signed here.

The client is this machine's own user's, as a configuration file starts it; nothing of it is believed at the server.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

from mcp.server.stdio import stdio_server

from pep.base.errors import UpstreamError
from pep.mcp.gateway.relay import UpstreamRelay
from pep.mcp.gateway.upstream import ToolUpstream
from pep.mcp.gateway.upstream_config import UpstreamConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    import httpx2

NAME: Final = "server"
"""Name of the one server, for its errors."""


async def bridge(url: str, auth: httpx2.Auth, *, timeout_s: float, told: Callable[[str], None]) -> None:
    """Serves stdin and stdout until stdin ends.

    Args:
        url: of the server.
        auth: signs each request.
        timeout_s: longest wait for an answer; a motion may last minutes.
        told: hears of the connection, in words.

    Raises:
        UpstreamError: the server does not answer, so that nothing was served.
    """
    states: list[str] = []

    def changed(words: str) -> None:
        states.append(words)
        told(words)

    config = UpstreamConfig(name=NAME, url=url, timeout_s=timeout_s, resources=True, prompts=True, tool=None)
    upstream = ToolUpstream(config, changed, auth=auth)
    relay = UpstreamRelay((upstream,), None, admitted=lambda _: True)
    running: asyncio.Task[Any] = asyncio.create_task(upstream.run())
    try:
        await upstream.tried()
        if states[-1] != ToolUpstream.CONNECTED:
            raise UpstreamError(url, states[-1])
        relay.introduce()
        async with stdio_server() as (read, write):
            await relay.server.run(read, write, relay.server.create_initialization_options())
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

"""HTTP app of an MCP server, and the sessions that it keeps for clients of the protocol before 2026-07-28.

A session is of the holder's key that opened it. It carries no authority: each request of it has a token and proof of
its own. A stream that stays open, for what a server tells later, ends with the authority of its holder.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from mcp.server.auth.middleware.bearer_auth import AuthenticatedUser
from mcp.server.auth.provider import AccessToken
from mcp.server.transport_security import TransportSecuritySettings

from capabilities.keys.keys import b64u, thumbprint_bytes
from capabilities.values.chain import Chain
from pep.mcp.http_request import CREDENTIALS, HTTP_REQUEST, answer
from pep.request.authority import NOBODY

if TYPE_CHECKING:
    from collections.abc import Callable

    from mcp.server.lowlevel.server import Server
    from mcp.server.mcpserver import MCPServer
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from pep.request.authority import Credentials

    Standing = Callable[[Credentials], bool]

SESSIONS: Final = 512
"""Ours: most sessions at once."""
HOLDER_SESSIONS: Final = 16
"""Ours: most sessions of one holder; the next one ends the oldest."""
IDLE_S: Final = 600.0
"""Ours: a session without a request for so long is over."""
HOLDER_STREAMS: Final = 16
"""Ours: most streams of one holder that stay open."""
STREAM_S: Final = 3600.0
"""Ours: longest time for which one stays open; its client opens another."""
LOOK_S: Final = 2.0
"""Ours: pause between two looks at the authority of its holder."""
SESSION_ID: Final = b"mcp-session-id"
LISTEN: Final = "subscriptions/listen"


def http_app(server: MCPServer[Any] | Server[Any], audience: str, *, standing: Standing | None) -> ASGIApp:
    """The app of one of the SDK's own servers, which answers at its audience alone.

    Args:
        server: of the tools.
        audience: its canonical URL.
        standing: whether a caller's authority is still good; None: the server keeps no sessions.
    """
    parts = urlsplit(audience)
    app = server.streamable_http_app(
        streamable_http_path=parts.path,
        stateless_http=standing is None,
        session_idle_timeout=IDLE_S,
        max_sessions=SESSIONS,
        transport_security=TransportSecuritySettings(
            enable_dns_rebinding_protection=True,
            allowed_hosts=[parts.netloc],
            allowed_origins=[f"{parts.scheme}://{parts.netloc}"],
        ),
    )
    return app if standing is None else SessionLayer(app, standing=standing)


class SessionLayer:
    """ASGI layer between the edge that verifies callers and an app that keeps sessions.

    Args:
        app: the MCP server's.
        standing: whether a caller's authority is still good.
    """

    def __init__(self, app: ASGIApp, *, standing: Standing) -> None:
        self._app = app
        self._standing = standing
        self._opened: dict[str, list[bytes]] = {}
        self._streams: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection; one of a verified caller is of its key."""
        credentials: Credentials = scope.get(CREDENTIALS, NOBODY)
        chain = credentials.chain
        if scope["type"] != "http" or credentials.fault is not None or not isinstance(chain, Chain):
            await self._app(scope, receive, send)
            return
        owner = b64u(thumbprint_bytes(chain.leaf.key))
        # The SDK gives a session only to the user who opened it.
        user = AccessToken(token="", client_id=owner, scopes=[], subject=chain.leaf.agent)
        scope["user"] = AuthenticatedUser(user)
        asked = scope[HTTP_REQUEST].rpc.get("method")
        if scope["method"] == "GET" or asked == LISTEN:
            await self._staying(owner, credentials, scope, receive, send)
        elif asked == "initialize":
            await self._opening(owner, scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _opening(self, owner: str, scope: Scope, receive: Receive, send: Send) -> None:
        opened = self._opened.pop(owner, [])
        self._opened[owner] = opened
        if len(self._opened) > SESSIONS:
            del self._opened[next(iter(self._opened))]
        while len(opened) >= HOLDER_SESSIONS:
            await self._end(opened.pop(0), scope)

        async def noted(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] < 400:
                opened.extend(value for name, value in message["headers"] if name.lower() == SESSION_ID)
            await send(message)

        await self._app(scope, receive, noted)

    async def _end(self, session: bytes, scope: Scope) -> None:
        """Ends a session of the same owner, where it is not over yet."""
        headers = [(name, value) for name, value in scope["headers"] if name in {b"host", b"origin"}]

        async def receive() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Message) -> None:
            pass

        ending = {**scope, "method": "DELETE", "headers": [*headers, (SESSION_ID, session)], "state": {}}
        await self._app(ending, receive, send)

    async def _staying(self, owner: str, caller: Credentials, scope: Scope, receive: Receive, send: Send) -> None:
        """A stream that is open until its client goes, or its holder's authority or its time is over."""
        if self._streams[owner] >= HOLDER_STREAMS:
            await answer(send, 503, b"")
            return
        begun = over = False

        async def noted(message: Message) -> None:
            nonlocal begun, over
            begun = True
            over = message["type"] == "http.response.body" and not message.get("more_body", False)
            await send(message)

        loop = asyncio.get_running_loop()
        ends_at = loop.time() + STREAM_S
        self._streams[owner] += 1
        serving = asyncio.ensure_future(self._app(scope, receive, noted))
        try:
            while not (await asyncio.wait({serving}, timeout=LOOK_S))[0]:
                if loop.time() > ends_at or not self._standing(caller):
                    serving.cancel()
                    await asyncio.wait({serving})
            if not serving.cancelled():
                serving.result()
            elif not begun:
                await answer(send, 503, b"")
            elif not over:
                await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            serving.cancel()
            self._streams[owner] -= 1
            self._streams += Counter()

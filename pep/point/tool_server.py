"""Guard of a tool server without a robot: the parts of an enforcement point, a gate, and a door.

    app = guard(server, "guard.toml")
    app.run()

serves it at its audience; any other ASGI server may do so, too, and `app.run_stdio()` serves stdin and stdout. The
app's own lifespan starts and ends the feeds.
Nothing is served before every tool is declared, registered and as it was approved; without a present view of
revocations nothing is permitted.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final
from urllib.parse import urlsplit

from capabilities.values.caps import DEFAULT as CAPS
from pep.base.errors import ConfigError, PepError, PepFault
from pep.mcp import guard as tool_guard
from pep.mcp import stdio_wire
from pep.mcp.declared_tools import decorated, rows_of
from pep.mcp.http_request import Refusals
from pep.mcp.provenance import Vouching
from pep.mcp.tool_digest import ToolPin, definition_digest
from pep.point.deciding_point import DecidingPoint
from pep.point.evaluation_layer import EvaluationLayer
from pep.point.guard_config import GuardConfig

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Mapping

    from starlette.types import Message, Receive, Scope, Send

    from pep.base.operation_row import Operation
    from pep.mcp.guard import AnyServer, CallContext, ServedTools

LOOPBACK: Final = "127.0.0.1"
HTTP_PORT: Final = 80
"""Port of an `http` URL that states none (RFC 9110, section 4.2.1)."""


def guard(server: AnyServer, config: GuardConfig | Path | str) -> GuardedServer:
    """The guarded HTTP app of a tool server: no tool of it can be reached but through the gate.

    Args:
        server: its tools declared by `operation`, or in the configuration.
        config: the configuration, or the path of its file.

    Raises:
        PepError: the configuration is refused, or what it names cannot be had or must not be believed.
    """
    return GuardedServer(server, config if isinstance(config, GuardConfig) else GuardConfig.read(config))


def pins(server: AnyServer, config: GuardConfig | Path | str | None = None) -> tuple[ToolPin, ...]:
    """The tools of a server as a person is to review and register them.

    Not to be called inside a running event loop.

    Args:
        server: as for `guard`.
        config: likewise, where it declares tools.

    Raises:
        PepError: a tool is declared wrongly or not at all.
    """
    stated = GuardConfig.read(config) if isinstance(config, str | Path) else config
    served, own = asyncio.run(tool_guard.tools_of(server)), asyncio.run(decorated(server))
    rows = rows_of(served, decorated=own, configured={} if stated is None else stated.rows())
    return tuple(ToolPin(each.name, definition_digest(each), each.name, rows[each.name].base_tier) for each in served)


class GuardedServer(DecidingPoint):
    """ASGI app of a tool server with all parts of an enforcement point.

    Args:
        server: of the tools.
        config: of the guard.
        vouching: gives the provenance of values at this point; without it no receipt is believed, and none given, and
            a response is signed as one whose arguments may be tainted.

    Attributes:
        keeps_sessions: over HTTP, for clients of the protocol before 2026-07-28.
    """

    keeps_sessions: ClassVar[bool] = False

    def __init__(
        self,
        server: AnyServer,
        config: GuardConfig,
        *,
        vouching: Callable[[DecidingPoint], Vouching] | None = None,
    ) -> None:
        super().__init__(config)
        self._server = server
        self._configured = config.rows()
        # Filled at start: until then no tool can be called.
        self._rows: dict[str, Operation] = {}
        self._app = tool_guard.guard(
            server,
            gate=self.gate,
            authority=self.authority,
            registry=self.follower,
            tools=self._rows,
            asks=self.asks,
            readiness=None,
            audience=config.audience,
            issuer=config.issuer,
            clock=self.clock,
            access=self.access,
            served=self.served,
            listed=self.listed,
            kept=self.kept,
            about=self.about_task,
            vouching=self._signing() if vouching is None else vouching(self),
            sessions=self.keeps_sessions,
        )
        if config.authzen:
            self._app = EvaluationLayer(
                self._app,
                gate=self.gate,
                authority=self.authority,
                registry=self.follower,
                peps=self.follower.peps,
                tools=self._rows,
                served=partial(tool_guard.digests_of, server),
                audience=config.audience,
                access=self.access,
                clock=self.clock,
            )

    def _signing(self) -> Vouching:
        """Signs what tools answer to which request, and knows nothing of where values come from."""
        audience = self.config.audience
        return Vouching(key=self._key, audience=audience, admitters=dict, flow=None, caps=CAPS)

    async def about_task(
        self, ctx: CallContext, name: str, task_id: str, responses: dict[str, Any] | None
    ) -> Mapping[str, Any]:
        """Answer of the server of a name behind this one about a task of its own; here there is none."""
        raise NotImplementedError

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection, or the life of the whole app."""
        if scope["type"] == "lifespan":
            await self._live(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _live(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Lets the server live while the feeds run; a refusal ends the start."""
        unheard = [await receive()]

        async def told() -> Message:
            return unheard.pop() if unheard else await receive()

        try:
            async with self.living():
                await self._app(scope, told, send)
        except PepError as error:
            await send({"type": "lifespan.startup.failed", "message": str(error)})

    async def served(self, ctx: CallContext, name: str) -> ServedTools:  # noqa: ARG002 - the list is the whole one
        """Tools as the server lists them now; those of the name are among them."""
        return await tool_guard.tools_of(self._server, ctx)

    def listed(self, ctx: CallContext, name: str) -> ServedTools:  # noqa: ARG002 - asking takes no time
        """Tools of that name as the server listed them last; none where it is to be asked."""
        return ()

    def run(self, *, host: str = "", port: int = 0) -> None:
        """Serves until SIGINT or SIGTERM.

        Args:
            host: address to listen at; "" is the audience's own.
            port: likewise; 0 is the audience's own.

        Raises:
            ConfigError: `CONFIG_INVALID`: an audience of `https` is served behind what ends its TLS, at a stated port.
            SystemExit: it does not start, and has said why.
        """
        import uvicorn  # none where another server serves the app

        audience = urlsplit(self.config.audience)
        if audience.scheme != "http" and not port:
            said = "audience: https is served behind a proxy; state the port to listen at, as run(port=8900)"
            raise ConfigError(PepFault.CONFIG_INVALID, said)
        here = host or (audience.hostname if audience.scheme == "http" else None) or LOOPBACK
        listens = self.listens

        class Telling(uvicorn.Server):
            async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                await super().startup(sockets)
                listens()

        config = uvicorn.Config(
            self,
            host=here,
            port=port or audience.port or HTTP_PORT,
            loop="asyncio",
            ws="none",
            log_level="warning",
            access_log=False,
            server_header=False,
        )
        with suppress(KeyboardInterrupt):
            Telling(config).run()

    def listens(self) -> None:
        """Is told by `run` once callers can connect; nothing to do here."""

    def run_stdio(self) -> None:
        """Serves one client over this process's stdin and stdout, until stdin ends.

        Raises:
            SystemExit: it does not start, and says why.
        """
        if said := asyncio.run(self._stdio()):
            raise SystemExit(said)

    async def _stdio(self) -> str:
        """Serves stdin and stdout; the refusal of a start in words, else empty."""
        async with stdio_wire.claimed() as wire:
            try:
                async with self.living():
                    await wire.serve(tool_guard.lowlevel(self._server), Refusals(self.gate, self.clock))
            except PepError as error:
                return str(error)
        return ""

    async def declare(self) -> None:
        """Lets the declared tools be called.

        Raises:
            DeclarationError: a tool is declared wrongly or not at all, unknown to the registry, or another one there.
        """
        served = await tool_guard.tools_of(self._server)
        rows = rows_of(served, decorated=await decorated(self._server), configured=self._configured)
        for tool in served:
            self.check_registered(tool.name, definition_digest(tool))
        await self.hear(rows.values())
        self._rows.update(rows)

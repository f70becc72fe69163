"""Guard of a tool server without a robot: the parts of an enforcement point, a gate, and a door.

    app = guard(server, "guard.toml")

The app's own lifespan starts and ends the feeds. Nothing is served before every tool is declared, registered and as it
was approved; without a present view of revocations nothing is permitted.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pep.base.errors import ConfigError, DeclarationError, PepError, PepFault
from pep.gate.gate import Gate
from pep.mcp import guard as tool_guard
from pep.mcp.declared_tools import decorated, rows_of
from pep.mcp.tool_digest import ToolPin, definition_digest
from pep.point.deferrals import Deferrals, recover_gate
from pep.point.guard_config import GuardConfig
from pep.point.parts import PointParts, opened

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from pep.base.operation_row import Operation
    from pep.mcp.guard import AnyServer
    from pep.request.edge import Edge

ASK_MS: Final = 600_000
"""Time for which an ask about an act waits for people.

Ours: the world of an act changes more slowly than that of an arm.
"""


def guard(server: AnyServer, config: GuardConfig | Path | str) -> ASGIApp:
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
    served = asyncio.run(tool_guard.tools_of(server))
    rows = rows_of(served, decorated=decorated(server), configured={} if stated is None else stated.rows())
    return tuple(ToolPin(each.name, definition_digest(each), each.name, rows[each.name].base_tier) for each in served)


class GuardedServer(PointParts):
    """ASGI app of a tool server with all parts of an enforcement point.

    Args:
        server: of the tools.
        config: of the guard.
    """

    def __init__(self, server: AnyServer, config: GuardConfig) -> None:
        try:
            config.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, f"folder: {type(error).__name__}") from error
        inputs = opened(config)
        trust, key, policies = inputs["trust"], inputs["key"], inputs["policies"]
        super().__init__(config, trust=trust, key=key, http=inputs["http"])
        self._server = server
        self._configured = config.rows()
        people = Deferrals.of(self, journal=self.journal, timeout_ms=ASK_MS, trust=trust, key=key)
        self._asking = people.asking
        self.gate = Gate(
            clock=self.clock,
            authority=self.authority,
            registry=self.follower,
            robot=None,
            policies=policies,
            journal=self.journal,
            asks=people.asks,
            announcer=people.asking,
        )
        recover_gate(self.journal, gate=self.gate, asks=people.asks, proofs=self.recover)
        # Filled at start: until then no tool can be called.
        self._rows: dict[str, Operation] = {}
        self._app = tool_guard.guard(
            server,
            gate=self.gate,
            authority=self.authority,
            registry=self.follower,
            tools=self._rows,
            asks=people.asks,
            readiness=None,
            audience=config.audience,
            issuer=config.issuer,
            clock=self.clock,
        )

    @property
    def edge(self) -> Edge:
        """The gate."""
        return self.gate

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        return {**super().beside(), "asking": self._asking.run()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection, or the life of the whole app."""
        if scope["type"] == "lifespan":
            await self._live(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _live(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Starts the feeds, compares the tools, and lets the server live; a refusal ends the start."""
        begun = await receive()
        tasks = [self.incidents.watched(what, part) for what, part in self.beside().items()]
        try:
            try:
                await self.first_view()
                await self._declare()
            except PepError as error:
                await send({"type": "lifespan.startup.failed", "message": str(error)})
                return
            unheard = [begun]

            async def told() -> Message:
                return unheard.pop() if unheard else await receive()

            await self._app(scope, told, send)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self.release()

    async def _declare(self) -> None:
        """Lets the declared tools be called.

        Raises:
            DeclarationError: a tool is declared wrongly or not at all, unknown to the registry, or another one there.
        """
        served = await tool_guard.tools_of(self._server)
        rows = rows_of(served, decorated=decorated(self._server), configured=self._configured)
        for tool in served:
            registered = self.follower.tool(tool.name)
            if registered is None or registered.operation != tool.name:
                raise DeclarationError(PepFault.TOOL_UNKNOWN, tool.name)
            if registered.definition_digest != definition_digest(tool):
                raise DeclarationError(PepFault.TOOL_DEFINITION_CHANGED, tool.name)
        self._rows.update(rows)

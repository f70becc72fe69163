"""Gateway before MCP servers that nobody changed: their tools behind the guard, as they were reviewed.

    gateway = ToolGateway(ToolGatewayConfig.read("gateway.toml"))
    gateway.run()

serves them at its audience. A server that is not there, or a tool that is not as it was approved, keeps nobody else
from being served: it cannot be called.
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from pep.base.errors import DeclarationError, UpstreamError
from pep.mcp.declared_tools import rows_of
from pep.mcp.gateway.lock import Lock
from pep.mcp.gateway.relay import UpstreamRelay
from pep.mcp.gateway.upstream import CONNECT_S, ToolUpstream
from pep.mcp.tool_digest import ToolPin, definition_digest
from pep.point.tool_server import GuardedServer

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping

    from pep.mcp.guard import CallContext, ServedTool, ServedTools
    from pep.point.tool_gateway_config import ToolGatewayConfig


async def reviewed(config: ToolGatewayConfig) -> tuple[tuple[ToolPin, ...], Lock]:
    """The mapped tools as a person is to register them, and all that the servers say of themselves.

    Args:
        config: of the gateway.

    Raises:
        UpstreamError: a server does not answer.
        DeclarationError: a tool does not fit its mapping, or its server has no such tool.
    """
    servers = tuple(ToolUpstream(each, lambda _: None) for each in config.upstreams)
    relay = UpstreamRelay(servers, Lock({}), admitted=lambda _: True)
    async with AsyncExitStack() as stack:
        for each in servers:
            task = asyncio.create_task(each.run())
            stack.callback(task.cancel)
        await asyncio.gather(*(each.tried() for each in servers))
        lock = await Lock.of(servers)
        served = [tool for each in servers for tool in await relay.mapped(each)]
    rows = rows_of(served, decorated={}, configured=config.rows())
    pins = (ToolPin(each.name, definition_digest(each), each.name, rows[each.name].base_tier) for each in served)
    return tuple(pins), lock


class ToolGateway(GuardedServer):
    """ASGI app of a gateway.

    Args:
        config: of it.
        ready: is told by `run` once every server that is there was heard, and callers can connect.
    """

    keeps_sessions = True

    def __init__(self, config: ToolGatewayConfig, *, ready: Callable[[ToolGateway], None] = lambda _: None) -> None:
        self._ready = ready
        self._upstreams = {each.name: ToolUpstream(each, partial(self._state, each.name)) for each in config.upstreams}
        self._relay = UpstreamRelay(
            tuple(self._upstreams.values()), Lock.read(config.lock), admitted=self._admit, approved=self._is_approved
        )
        self._digests: dict[str, str] = {}
        self._faults: dict[str, str] = {}
        super().__init__(self._relay.server, config)

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        return {**super().beside(), **{f"upstream {name}": each.run() for name, each in self._upstreams.items()}}

    async def declare(self) -> None:
        """Lets the mapped tools of each server that is there be called; those of another follow when it comes."""
        await self.hear(self._configured.values())
        with suppress(TimeoutError):
            async with asyncio.timeout(CONNECT_S):
                await asyncio.gather(*(each.tried() for each in self._upstreams.values()))
        await asyncio.gather(*(self._heard(name) for name in self._upstreams))

    def listens(self) -> None:
        """Tells that it is ready."""
        self._ready(self)

    @property
    def tools(self) -> tuple[str, ...]:
        """Names of the tools that can be called now."""
        return tuple(sorted(self._rows.keys() - self.faults().keys()))

    async def served(self, ctx: CallContext, name: str) -> ServedTools:
        """Tools of that name as the one server that has it lists them now to this caller.

        Raises:
            UpstreamError: it does not answer.
        """
        return await self._relay.tools(name, ctx)

    def listed(self, ctx: CallContext, name: str) -> ServedTools:
        """Tools of that name as their server listed them last; none while it is not connected for this caller."""
        return self._relay.latest(ctx, name)

    async def about_task(
        self, ctx: CallContext, name: str, task_id: str, responses: dict[str, Any] | None
    ) -> Mapping[str, Any]:
        """Answer of the server of that name about a task of its own."""
        return await self._relay.about_task(ctx, name, task_id, responses)

    def faults(self) -> dict[str, str]:
        """Reasons why mapped tools cannot be called, by the tool's name, as of the latest look."""
        waiting = dict.fromkeys(self._configured, "its server has no such tool, or is not there")
        known = {name: self._registered_fault(name, digest) for name, digest in self._digests.items()}
        return {name: fault for name, fault in {**waiting, **known, **self._faults}.items() if fault}

    def _is_approved(self, tool: ServedTool) -> bool:
        return not self._registered_fault(tool.name, definition_digest(tool))

    def _registered_fault(self, name: str, digest: str) -> str:
        try:
            self.check_registered(name, digest)
        except DeclarationError as error:
            return str(error.code)
        return ""

    def _state(self, name: str, words: str) -> None:
        self.note({"what": "upstream", "server": name, "state": words})
        if words == ToolUpstream.CONNECTED:
            self.incidents.watched("upstream", self._heard(name))

    async def _heard(self, name: str) -> None:
        """Admits the tools of a server, where it answers."""
        with suppress(UpstreamError):
            await self._relay.mapped(self._upstreams[name])
        self._relay.introduce()

    def _admit(self, tool: ServedTool) -> bool:
        """True where a tool fits its mapping as it is now; its row is then that of this definition.

        Else the row of an earlier one stays, so that a call is still compared with what the server says by then.
        """
        digest = definition_digest(tool)
        if self._digests.get(tool.name) == digest:
            return tool.name not in self._faults
        self._digests[tool.name] = digest
        try:
            row = rows_of([tool], decorated={}, configured={tool.name: self._configured[tool.name]})[tool.name]
        except DeclarationError as error:
            self._faults[tool.name] = str(error)
            self.note({"what": "tool", "tool": tool.name, "fault": str(error)})
            return False
        self._faults.pop(tool.name, None)
        if self._rows.get(tool.name) != row:
            self._rows[tool.name] = row
        return True

"""One run: the same act through the gateway, through FastMCP's proxy and directly, and with a guard over stdio."""

from __future__ import annotations

import asyncio
import json
import random
import sys
import time
from contextlib import AsyncExitStack, ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mcp import Client, StdioServerParameters
from mcp.client.streamable_http import streamable_http_client

from evaluation.harness.absent import package
from evaluation.harness.machine import machine
from evaluation.tools import act, parts
from evaluation.tools.mcp_bench import Fronts, McpResult
from evaluation.tools.place import FRONTS, PROGRAM, SERVER, place
from evaluation.tools.served import BARE_PATH
from evaluation.tools.turns import check_refused, finished, in_turns
from pep import GuardConfig, pins
from pep.point.tool_gateway import reviewed
from pep.point.tool_gateway_config import ToolGatewayConfig
from ztpm.base.processes import Child
from ztpm_idp.client import direct_http

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping
    from pathlib import Path

    from mcp_types import CallToolResult

    from evaluation.tools.bench import ActRow
    from evaluation.tools.place import Place
    from evaluation.tools.turns import Act
    from ztpm_idp.client import Agent
    from ztpm_idp.client.tools import Tools

PACKAGE: Final = "evaluation.tools"
STDIO: Final = (sys.executable, "-m", f"{PACKAGE}.over_stdio")
"""Command of the server over stdio."""
MAPPING: Final = f"""
[upstream.plant.tool.{act.NAME}]
object = "valves"
base_tier = 1
[upstream.plant.tool.{act.NAME}.arguments]
valve = {{ low = 1, high = 12, unit = "count", integer = true }}
percent = {{ low = 0, high = 1000, unit = "permille", scale = 10, above = {{ 800 = 3 }} }}
"""


def run(calls: int, *, seed: int, told: Callable[[str], None]) -> McpResult:
    """The act, so many times on each way.

    Args:
        calls: timed ones of each way.
        seed: of the order within each turn.
        told: receives the name of each step.

    Raises:
        AbsentError: FastMCP is not installed.
        NotMeasuredError: a call had a wrong answer, or too many were refused.
        ClientError: the provider or a server did not answer.
        ChildError: one of them did not start.
    """
    began = time.monotonic()
    versions = {name: package(module, name)[1] for module, name in (("fastmcp", "fastmcp-slim"), ("mcp", "mcp"))}
    told("starting an identity provider and a tool server")
    with place() as at, ExitStack() as served:
        measured = _Run(at, at.agent("worker"), calls, random.Random(seed), told)  # noqa: S311 - turns
        guarded = at.point("plant", SERVER, pins(act.server()))
        bare = Child.start("tool server", "evaluation.tools.served", str(guarded), environment=at.environment)
        served.callback(bare.stop)
        url = f"http://{at.host}:{SERVER}{BARE_PATH}"
        http = measured.fronts("http", (url,), f"url = {json.dumps(url)}")
        stdio = measured.fronts("stdio", STDIO, f"command = {json.dumps(list(STDIO))}")
        with_guard, without, record_us = measured.over_stdio()
    return McpResult(
        http,
        stdio,
        with_guard,
        without,
        record_us=record_us,
        seconds=time.monotonic() - began,
        machine=machine(),
        versions=versions,
    )


@dataclass(frozen=True, slots=True)
class _Run:
    """Arguments of a run, its place and its agent."""

    at: Place
    agent: Agent
    calls: int
    order: random.Random
    told: Callable[[str], None]

    def fronts(self, name: str, behind: tuple[str, ...], line: str) -> Fronts:
        """Both fronts of one server, and the server itself.

        Args:
            name: of the transport between the fronts and the server.
            behind: URL or command of the server.
            line: the same in a gateway's configuration.
        """
        at, (gateway_port, proxy_port) = self.at, FRONTS[name]
        self.told(f"a gateway and FastMCP's proxy before a server over {name}, {self.calls} calls of each")
        file = self._gateway(f"gateway-{name}", gateway_port, line)
        proxy = f"{PACKAGE}.fastmcp_proxy"
        with ExitStack() as served:
            for child in (
                Child.begin("gateway", f"{PACKAGE}.gateway", str(file), environment=at.environment),
                Child.begin("FastMCP's proxy", proxy, at.host, str(proxy_port), *behind, environment={}),
            ):
                served.callback(child.stop)
                child.until_ready()
            audience = ToolGatewayConfig.read(file).audience
            return Fronts(*finished(self._through(audience, f"http://{at.host}:{proxy_port}/mcp", behind)))

    def _gateway(self, name: str, port: int, line: str) -> Path:
        """Configuration file of a new gateway, registered with the tools of the server behind it as they are now."""
        file = self.at.point(name, port, ())
        file.write_text(f"{file.read_text()}[upstream.plant]\n{line}\n{MAPPING}")
        config = ToolGatewayConfig.read(file)
        tools, lock = asyncio.run(reviewed(config))
        self.at.register(config.audience, tools)
        config.lock.write_text(lock.text())
        return file

    async def _through(self, audience: str, proxy: str, behind: tuple[str, ...]) -> list[ActRow]:
        """Rows of the gateway, of FastMCP's proxy, and of the server alone."""
        kind = "HTTP" if len(behind) == 1 else "stdio"
        command, *arguments = behind
        token = self.at.lent(self.agent, act.open_valve, audience)
        async with AsyncExitStack() as opened:
            tools = await opened.enter_async_context(self.agent.tools(audience, token))
            http = await opened.enter_async_context(direct_http.async_client())
            server = (
                StdioServerParameters(command=command, args=arguments)
                if arguments
                else streamable_http_client(command, http_client=http)
            )
            through = await opened.enter_async_context(Client(streamable_http_client(proxy, http_client=http)))
            direct = await opened.enter_async_context(Client(server))
            ways = {
                f"gateway, {kind} behind": called(tools.call),
                f"FastMCP's proxy, {kind} behind": called(through.call_tool),
                f"the server itself, {kind}": called(direct.call_tool),
            }
            return await self._in_turns(tools, ways)

    def over_stdio(self) -> tuple[ActRow, ActRow, float]:
        """Rows of the guarded process and of the other one, and microseconds of the records of one act."""
        file = self.at.point("process", PROGRAM, pins(act.server()))
        self.told(f"a guarded and an unguarded process over stdio, {self.calls} calls of each")
        guarded, bare = finished(self._over_stdio(file))
        return guarded, bare, asyncio.run(parts.record_us(GuardConfig.read(file).state_dir, self.calls))

    async def _over_stdio(self, file: Path) -> list[ActRow]:
        audience = GuardConfig.read(file).audience
        token = self.at.lent(self.agent, act.open_valve, audience)
        command, *given = STDIO
        behind_guard = StdioServerParameters(command=command, args=[*given, str(file)], env=self.at.environment)
        async with (
            self.agent.tools_stdio(behind_guard, token, audience=audience) as tools,
            Client(StdioServerParameters(command=command, args=given)) as bare,
        ):
            ways = {"guarded, stdio": called(tools.call), "unguarded, stdio": called(bare.call_tool)}
            return await self._in_turns(tools, ways)

    async def _in_turns(self, guarded: Tools, ways: Mapping[str, Act]) -> list[ActRow]:
        await check_refused(lambda: guarded.call(act.NAME, act.OUTSIDE))
        return await in_turns(ways, {"result": act.ANSWER}, self.calls, self.order, self.told)


def called(call: Callable[..., Awaitable[CallToolResult]]) -> Act:
    """The act through the `call` of a client."""

    async def once() -> object:
        return (await call(act.NAME, dict(act.ARGUMENTS))).structured_content

    return once

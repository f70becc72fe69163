"""Clients that others wrote, each on one running cell: its list of tools, a motion, and a refusal.

Each gives the names of the tools, and what a model would read of both acts.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import httpx2
import pytest
from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client
from mcp.client.streamable_http import streamable_http_client
from tests.e2e.test_up import PASSPHRASE, Caller, Running, until
from tests.house.pages import BLOCK
from tests.node_packages import installed, node
from ztpm.stage.stage import ACCELERATION_RAD_S2, RIGHT, SPEED_RAD_S

fastmcp = pytest.importorskip("fastmcp", reason="the extra `fastmcp` is not installed")
pytest.importorskip("pydantic_ai.mcp", reason="the extra `pydantic-ai` is not installed")
from pydantic_ai import Agent  # noqa: E402
from pydantic_ai.messages import ModelResponse, TextPart, ToolCallPart  # noqa: E402
from pydantic_ai.models.function import FunctionModel  # noqa: E402

pytestmark = [
    pytest.mark.e2e, pytest.mark.version, pytest.mark.real_time, pytest.mark.timeout(600),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]  # fmt: skip
LENT = ["gripper_move", "move_joint", "read_state", "stop"]
"""Tools that the token lends; the cell has more."""
NODE_CLIENTS = Path(__file__).parent / "node_clients"
PAGE = (Path(__file__).parents[2] / "docs" / "guard.md").read_text("utf-8")
RECIPE = next(text for _, text in BLOCK.findall(PAGE) if "MCPToolset" in text)
LONGEST_S = 60


def to(angle, speed=SPEED_RAD_S):
    """Arguments of a motion of the base joint."""
    return {"q_rad": [angle, *RIGHT[1:]], "speed_rad_s": speed, "acceleration_rad_s2": ACCELERATION_RAD_S2}


class Cell:
    """A running `ztpm up`, an agent that is lent part of it, and eyes of our own on the arm."""

    def __init__(self, running, folder):
        self.running, self.folder = running, folder
        self.caller = Caller(running)
        self.audience = self.caller.audience
        self.token = folder / "mover.token"
        self.token.write_text(self.caller.lent.token)
        self.env = os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE, "HOME": str(folder), "NO_COLOR": "1"}

    @property
    def auth(self):
        return self.caller.agent.auth(self.caller.lent.token)

    @property
    def bridge(self):
        """Command and arguments of the bridge."""
        data = self.running.told["data"]
        connect = ["mcp", "connect", "mover", self.audience, "--token", str(self.token), "--data", data]
        return str(Path(sys.executable).with_name("ztpm")), connect

    @property
    def host(self):
        """A host's own file, as docs/hosts.md has it."""
        command, arguments = self.bridge
        path, env = self.folder / "mcp.json", {"ZTPM_PASSPHRASE": PASSPHRASE}
        path.write_text(json.dumps({"mcpServers": {"plant": {"command": command, "args": arguments, "env": env}}}))
        return path

    async def printed(self, *command):
        """The JSON that a program prints."""
        run = await asyncio.create_subprocess_exec(
            *command, env=self.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        out, err = await asyncio.wait_for(run.communicate(), LONGEST_S)
        assert out, err.decode()
        return json.loads(out)

    def base_rad(self):
        """The base joint, as the controller tells it."""
        return self.eyes.getActualQ()[0]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    from rtde_receive import RTDEReceiveInterface

    folder = tmp_path_factory.mktemp("clients")
    running = Running(folder / "cell")
    try:
        made = Cell(running, folder)
        until(lambda: made.caller.move().decision == "PERMIT", "it moves")
        made.eyes = RTDEReceiveInterface(running.told["controller"])
        yield made
        made.eyes.disconnect()
    finally:
        running.end()


async def by_sdk_client(client, acts):
    names = [tool.name for tool in (await client.list_tools()).tools]
    return names, [(await client.call_tool("move_joint", act)).content[0].text for act in acts]


async def sdk(cell, acts):
    async with (
        httpx2.AsyncClient(auth=cell.auth, timeout=LONGEST_S) as http,
        Client(streamable_http_client(cell.audience, http_client=http)) as client,
    ):
        return await by_sdk_client(client, acts)


async def bridge(cell, acts):
    command, arguments = cell.bridge
    with (cell.folder / "bridge.log").open("w") as log:
        started = StdioServerParameters(command=command, args=arguments, env=cell.env)
        async with Client(stdio_client(started, errlog=log)) as client:
            return await by_sdk_client(client, acts)


async def fast(cell, acts):
    transport = fastmcp.client.transports.StreamableHttpTransport(cell.audience, auth=cell.auth)
    async with fastmcp.Client(transport, timeout=LONGEST_S) as client:
        names = [tool.name for tool in await client.list_tools()]
        told = [await client.call_tool("move_joint", act, raise_on_error=False) for act in acts]
        return names, [each.content[0].text for each in told]


async def pydantic(cell, acts):
    """An agent with the recipe of docs/guard.md, whose model calls each act in turn."""
    names, told, recipe = [], [], {"__name__": "recipe"}
    exec(compile(RECIPE, "docs/guard.md", "exec"), recipe)

    def answer(messages, info):
        names[:] = [tool.name for tool in info.function_tools]
        told[:] = [
            part.model_response_str()
            for message in messages
            for part in message.parts
            if part.part_kind == "tool-return"
        ]
        if len(told) < len(acts):
            return ModelResponse(parts=[ToolCallPart("move_joint", acts[len(told)])])
        return ModelResponse(parts=[TextPart("done")])

    await Agent(FunctionModel(answer), toolsets=[recipe["toolset"](cell.audience, cell.auth)]).run("move")
    return names, told


async def typescript(cell, acts):
    kept = installed(NODE_CLIENTS)
    shutil.copy(NODE_CLIENTS / "call.mjs", kept / "call.mjs")
    command, arguments = cell.bridge
    command = json.dumps({"command": command, "args": arguments, "env": dict(cell.env)})
    said = await cell.printed(node(), str(kept / "call.mjs"), command, "move_joint", json.dumps(acts))
    return said["tools"], [each["content"][0]["text"] for each in said["told"]]


async def inspector(cell, acts):
    launcher = "node_modules/@modelcontextprotocol/inspector/clients/launcher/build/index.js"
    command = (
        node(),
        str(installed(NODE_CLIENTS) / launcher),
        "--cli",
        "--config",
        str(cell.host),
        "--server",
        "plant",
    )
    names = [tool["name"] for tool in (await cell.printed(*command, "--method", "tools/list"))["tools"]]
    told = []
    for act in acts:
        given = [f"{name}={json.dumps(value)}" for name, value in act.items()]
        call = ("--method", "tools/call", "--tool-name", "move_joint", "--tool-arg", *given)
        told.append((await cell.printed(*command, *call))["content"][0]["text"])
    return names, told


CLIENTS = (sdk, bridge, fast, pydantic, typescript, inspector)


@pytest.mark.parametrize(
    "client",
    [pytest.param(each, id=each.__name__, marks=pytest.mark.campaign if each is inspector else ()) for each in CLIENTS],
)
def test_a_client_is_shown_what_it_is_lent_moves_the_arm_and_is_told_why_not(cell, client):
    angle = round(0.55 - 0.05 * CLIENTS.index(client), 2)
    until_s, reached = time.monotonic() + LONGEST_S, False
    while not reached and time.monotonic() < until_s:  # a machine that is slow for a moment is refused, or stopped
        names, (done, refused) = asyncio.run(client(cell, (to(angle), to(0.6, speed=1.2))))
        reached = '"outcome":"reached"' in done.replace(" ", "")
    assert reached, done
    assert sorted(names) == LENT
    assert "LIMIT_EXCEEDED_BY_REQUEST" in refused and "1050000" in refused
    assert abs(cell.base_rad() - angle) < 2e-3

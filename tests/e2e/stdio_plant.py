"""A guarded plant over stdio, of any kind of server: `stdio_plant.py KIND guard.toml`. Its tool writes where it can.

With the word `http` behind them it is served at its audience.
"""

import json
import os
import subprocess
import sys
from typing import Annotated

from mcp.server import MCPServer
from mcp.server.lowlevel.server import Server
from mcp_types import CallToolResult, ListToolsResult, TextContent, Tool

from pep import Within, guard, operation

TABLE = """
[tool.open_valve]
object = "valve-7"
base_tier = 1
[tool.open_valve.arguments]
percent = { low = 0, high = 1000, unit = "permille", scale = 10, above = { 800 = 3 } }
"""
SCHEMA = {"type": "object", "properties": {"percent": {"type": "number"}}, "required": ["percent"]}


@operation("valve-7", base_tier=1)
def open_valve(percent: Annotated[float, Within(0, 1_000, "permille", scale=10, above={800: 3})]) -> float:
    """Open the valve."""
    print("noise of the tool", flush=True)
    child = subprocess.run(["sh", "-c", "echo noise of a child; cat"], timeout=20, check=True)  # it reads to the end
    sys.stderr.write(f"opened {percent} {child.returncode}\n")
    return percent


def sdk():
    server = MCPServer("plant", log_level="ERROR")
    server.tool()(open_valve)
    return server


def fastmcp():
    from fastmcp import FastMCP

    server = FastMCP("plant")
    server.tool(open_valve)
    return server


def lowlevel():
    async def listed(ctx, params):
        return ListToolsResult(tools=[Tool(name="open_valve", description="Open the valve.", input_schema=SCHEMA)])

    async def called(ctx, params):
        assert "dev.ztpm/" not in json.dumps([ctx.params, ctx.meta], default=str)
        value = open_valve(params.arguments["percent"])
        return CallToolResult(content=[TextContent(type="text", text=str(value))], structured_content={"result": value})

    return Server("plant", on_list_tools=listed, on_call_tool=called)


KINDS = {"sdk": (sdk, ""), "fastmcp": (fastmcp, ""), "lowlevel": (lowlevel, TABLE)}

if __name__ == "__main__":
    os.environ["NO_COLOR"] = "1"
    plant = guard(KINDS[sys.argv[1]][0](), sys.argv[2])
    plant.run() if sys.argv[3:] == ["http"] else plant.run_stdio()

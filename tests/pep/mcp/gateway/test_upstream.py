"""Servers as they are: of the older protocol, with words of their own on standard output, and without end."""

import asyncio
import sys

import pytest
from pep.mcp.gateway.upstream import ToolUpstream
from pep.mcp.gateway.upstream_config import UpstreamConfig

OLD = """
import json, sys
print("Warning: no robot library; what is done is simulated")
for line in sys.stdin:
    asked = json.loads(line)
    match asked["method"]:
        case "initialize":
            about = {"name": "old", "version": "1"}
            answer = {"protocolVersion": "2024-11-05", "capabilities": {"tools": {}}, "serverInfo": about}
        case "tools/list":
            print("listing")
            tool = {"name": "say", "description": "x" * 200_000, "inputSchema": {"type": "object", "properties": {"to": True}}}
            answer = {"tools": [tool]}
        case "notifications/initialized":
            continue
        case _:
            sys.exit(1)  # a question of the newer protocol, too
    print(json.dumps({"jsonrpc": "2.0", "id": asked["id"], "result": answer}), flush=True)
"""


async def listed(program):
    """States of the server once it was tried, and its tools."""
    states = []
    upstream = ToolUpstream(UpstreamConfig(name="old", command=(sys.executable, "-c", program)), states.append)
    running = asyncio.create_task(upstream.run())
    try:
        await asyncio.wait_for(upstream.tried(), 60)
        return list(states), await upstream.tools() if states[-1] == ToolUpstream.CONNECTED else None
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def test_a_server_that_ends_at_the_newer_protocol_is_tried_in_the_older_one_before_it_counts_as_tried():
    states, tools = asyncio.run(listed(OLD))
    assert (len(states), states[-1]) == (2, ToolUpstream.CONNECTED)
    assert [(each.name, len(each.description)) for each in tools] == [("say", 200_000)]


@pytest.mark.parametrize("program", ["", "print('no server')"])
def test_a_process_that_is_no_server_was_tried_all_the_same(program):
    states, tools = asyncio.run(listed(program))
    assert states[0].startswith("not connected")
    assert tools is None

"""Six guarded tools: `plant.py serve guard.toml`; or `plant.py use alice.key ISSUER URL`."""

import asyncio
import os
import sys
from pathlib import Path
from typing import Annotated

from mcp.server import MCPServer

from capabilities import Range, Restriction, key_from_pem
from pep import Within, Word, grant, guard, operation
from ztpm_idp.client import Denied, Operator

server = MCPServer("plant", log_level="ERROR")
DOCUMENTS = ("pump 7: how to vent it", "pump 7: spare parts", "oven: how to light it")
Metres = Annotated[float, Within(-50_000_000, 50_000_000, "um")]
Percent = Annotated[float, Within(0, 1_000, "permille", scale=10, above={800: 3})]
Speed = Annotated[float, Within(0, 2_000_000, "um_s", above={1_000_000: 3})]


@server.tool(description="Search the plant's documents.")
@operation("docs", base_tier=0)
def search_docs(query: str) -> list[str]:
    return [title for title in DOCUMENTS if query.lower() in title]


@server.tool(description="Read a temperature in degrees Celsius.")
@operation("plant", base_tier=0)
def read_sensor(id: Annotated[int, Within(1, 999)]) -> float:
    return 20.0 + id / 1000


@server.tool(description="Open a valve so far, in percent.")
@operation("valves", base_tier=1)
def open_valve(valve: Annotated[int, Within(1, 12)], percent: Percent) -> str:
    return f"valve {valve} is {percent} % open"


@server.tool(description="Set the oven to a temperature in degrees Celsius.")
@operation("oven", base_tier=2)
def set_temperature(degrees: Annotated[float, Within(150, 2_500, scale=10)]) -> float:
    return degrees


@server.tool(description="Drive to a place of the hall, in metres, at a speed in m/s.")
@operation("agv", base_tier=2)
def move_agv(x: Metres, y: Metres, speed: Speed) -> str:
    return f"at {x}, {y} with {speed} m/s"


@server.tool(description="Delete a record of the plant for good.")
@operation("records", base_tier=3)
def delete_record(id: Annotated[str, Word("path", under=["/records"])]) -> str:
    return f"record {id} is deleted"


async def use(alice: Operator, url: str) -> None:
    """Alice lends a planner three tools, and that a worker one of them, up to 40 %."""
    planner = alice.new_agent(f"planner-{os.getpid()}", __file__, role="planner")
    worker = alice.new_agent(f"worker-{os.getpid()}", __file__, role="worker")
    grants = grant(search_docs), grant(read_sensor), grant(open_valve)
    lent = alice.lend(planner, grants, url, purpose="air the hall", delegates=[worker.id])
    less = Restriction((grant(open_valve, percent=Range(0, 400)),))
    narrower = planner.delegate(lent.token, worker, less, purpose="open valve 3")
    async with worker.tools(url, narrower.token) as tools:
        for percent in 40, 45:
            try:
                answer = await tools.call("open_valve", {"valve": 3, "percent": percent})
                print(answer.content[0].text)
            except Denied as denied:
                print(denied.words)


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        guard(server, sys.argv[2]).run()
    else:
        key = key_from_pem(Path(sys.argv[2]).read_bytes(), os.environ["ZTPM_PASSPHRASE"].encode())
        asyncio.run(use(Operator("alice", key, sys.argv[3]), sys.argv[4]))

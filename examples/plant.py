"""A plant's tool server, guarded: six tools, their declarations beside them, and a call of `guard`.

`python examples/plant.py guard.toml` serves it; docs/guard.md says what guard.toml holds.
"""

import sys
from typing import Annotated
from urllib.parse import urlsplit

import uvicorn
from mcp.server import MCPServer

from pep import GuardConfig, Within, Word, guard, operation

server = MCPServer("plant", log_level="ERROR")
celsius, opened = 20.0, {}
DOCUMENTS = ("pump 7: how to vent it", "pump 7: spare parts", "oven: how to light it")

Metres = Annotated[float, Within(-50_000_000, 50_000_000, "um")]
Number = Annotated[int, Within(1, 999)]


@server.tool()
@operation("docs", base_tier=0)
def search_docs(query: str) -> list[str]:
    """Search the plant's documents."""
    return [title for title in DOCUMENTS if query.lower() in title]


@server.tool()
@operation("plant", base_tier=0)
def read_sensor(id: Number) -> float:
    """Read a temperature in degrees Celsius."""
    return celsius + id / 1000


@server.tool()
@operation("valves", base_tier=1)
def open_valve(
    valve: Annotated[int, Within(1, 12)],
    percent: Annotated[float, Within(0, 1_000, "permille", scale=10, above={800: 3})],
) -> float:
    """Open a valve so far, in percent; how far it is open now."""
    opened[valve] = percent
    return percent


@server.tool()
@operation("oven", base_tier=2)
def set_temperature(degrees: Annotated[float, Within(150, 2_500, scale=10)]) -> float:
    """Set the oven to a temperature in degrees Celsius."""
    global celsius
    celsius = degrees
    return degrees


@server.tool()
@operation("agv", base_tier=2)
def move_agv(
    x: Metres,
    y: Metres,
    speed: Annotated[float, Within(0, 2_000_000, "um_s", above={1_000_000: 3})],
) -> str:
    """Drive to a place of the hall, in metres, at a speed in m/s."""
    return f"at {x}, {y} with {speed} m/s"


@server.tool()
@operation("records", base_tier=3)
def delete_record(id: Annotated[str, Word("path", under=["/records"])]) -> str:
    """Delete a record of the plant for good."""
    return f"record {id} is deleted"


if __name__ == "__main__":
    config = GuardConfig.read(sys.argv[1])
    door = urlsplit(config.audience)
    uvicorn.run(guard(server, config), host=door.hostname, port=door.port, log_level="warning")

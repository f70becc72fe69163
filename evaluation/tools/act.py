"""Measured act: one declared function, a tool of two servers and a function of a program."""

from __future__ import annotations

from typing import Annotated, Final

from mcp.server import MCPServer

from pep import Within, operation

VALVE, ANSWER = 3, 45.0
ARGUMENTS: Final = {"valve": VALVE, "percent": ANSWER}
OUTSIDE: Final = {"valve": 13, "percent": ANSWER}
"""Arguments that no token permits: there are twelve valves."""


@operation("valves", base_tier=1)
def open_valve(
    valve: Annotated[int, Within(1, 12)],  # noqa: ARG001 - nothing is behind it
    percent: Annotated[float, Within(0, 1_000, "permille", scale=10, above={800: 3})],
) -> float:
    """Open a valve so far, in percent; how far it is open now."""
    return percent


NAME: Final = open_valve.__name__


def server() -> MCPServer:
    """Tool server with that act alone."""
    made = MCPServer("plant", log_level="ERROR")
    made.tool()(open_valve)
    return made

"""Process that serves FastMCP's own proxy of a server.

Its arguments are the address and port to serve at, and the URL of the server or its command.
"""

from __future__ import annotations

import sys

import uvicorn
from fastmcp.client.transports import StdioTransport
from fastmcp.server import create_proxy

from evaluation.harness.announcing import Announcing


def main() -> None:
    """Serves until it is told to end."""
    host, port, target, *arguments = sys.argv[1:]
    behind = target if target.startswith("http:") else StdioTransport(target, arguments)
    app = create_proxy(behind).http_app(path="/mcp", stateless_http=True)
    # As the guard is served, so that what is served is the only difference.
    config = uvicorn.Config(app, host=host, port=int(port), log_level="warning", loop="asyncio")
    Announcing(config).run()


if __name__ == "__main__":
    main()

"""Process that serves the bare endpoint: `python -m evaluation.idp.served DATABASE ISSUER HOST PORT`."""

from __future__ import annotations

import json
import signal
import sys
from typing import TYPE_CHECKING

import uvicorn

from capabilities.keys import keys
from evaluation.idp.bare import bare_app

if TYPE_CHECKING:
    import socket


class BareServer(uvicorn.Server):
    """Server that says on standard output, in one JSON line, that it listens."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listens, and says so."""
        await super().startup(sockets)
        sys.stdout.write(json.dumps({"ready": True}) + "\n")
        sys.stdout.flush()


def main() -> None:
    """Serves until it is told to end."""
    database, issuer, host, port = sys.argv[1:]
    # The server hands the signal back when it has ended in order; that is success, not death by signal.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    app = bare_app(database, issuer, keys.generate())
    # Loop and parser of the provider, which has no other in any environment.
    BareServer(
        uvicorn.Config(
            app, host=host, port=int(port), log_level="warning", access_log=False, loop="asyncio", http="h11"
        )
    ).run()


if __name__ == "__main__":
    main()

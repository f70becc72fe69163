"""Process that serves the bare endpoint: `python -m evaluation.idp.served DATABASE ISSUER HOST PORT`."""

from __future__ import annotations

import signal
import sys

import uvicorn

from capabilities.keys import keys
from evaluation.harness.announcing import Announcing
from evaluation.idp.bare import bare_app


def main() -> None:
    """Serves until it is told to end."""
    database, issuer, host, port = sys.argv[1:]
    # The server hands the signal back when it has ended in order; that is success, not death by signal.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    app = bare_app(database, issuer, keys.generate())
    # Loop and parser of the provider, which has no other in any environment.
    Announcing(
        uvicorn.Config(
            app, host=host, port=int(port), log_level="warning", access_log=False, loop="asyncio", http="h11"
        )
    ).run()


if __name__ == "__main__":
    main()

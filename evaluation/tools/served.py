"""Process that serves the act twice: behind the guard, and beside it without one."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import uvicorn
from mcp.server.transport_security import TransportSecuritySettings

from evaluation.harness.announcing import Announcing
from evaluation.tools import act
from pep import GuardConfig, guard

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

BARE_PATH: Final = "/bare"


def main() -> None:
    """Serves by the configuration that the command line names, until it is told to end."""
    config = GuardConfig.read(sys.argv[1])
    door = urlsplit(config.audience)
    guarded = guard(act.server(), config)
    # As the guard serves it, so that the guard is the only difference.
    bare = act.server().streamable_http_app(
        streamable_http_path=BARE_PATH,
        stateless_http=True,
        transport_security=TransportSecuritySettings(
            enable_dns_rebinding_protection=True,
            allowed_hosts=[door.netloc],
            allowed_origins=[f"{door.scheme}://{door.netloc}"],
        ),
    )

    async def both(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            async with bare.router.lifespan_context(bare):
                await guarded(scope, receive, send)
        elif scope.get("path") == BARE_PATH:
            await bare(scope, receive, send)
        else:
            await guarded(scope, receive, send)

    # The server hands the signal back when it has ended in order; that is success, not death by signal.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    # What the SDK itself brings, in any environment: other packages may bring a faster loop and parser.
    config_of = uvicorn.Config(
        both, host=door.hostname or "", port=door.port or 0, log_level="warning", loop="asyncio", http="h11"
    )
    Announcing(config_of).run()


if __name__ == "__main__":
    main()

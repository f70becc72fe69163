"""Running the identity provider in a process of its own."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import uvicorn

from ztpm_idp.app import create_app

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from capabilities.statements.workload import Platform
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.settings import Settings

HEADER_BYTES = 32_768
"""Headers that are read: a token of 16 KiB, its proof, and room."""
GRACE_S = 5
"""Seconds that open requests may take to end after SIGTERM."""


class _Announcing(uvicorn.Server):
    """Says on standard output, in one JSON line, that it listens; lets nobody wait once it is told to end."""

    def __init__(self, config: uvicorn.Config, *, port: int, ending: Callable[[], None]) -> None:
        super().__init__(config)
        self._port = port
        self._ending = ending

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            sys.stdout.write(json.dumps({"ready": True, "port": self._port}) + "\n")
            sys.stdout.flush()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        # The application is told of its end only after every request has ended; one that waits must be told before.
        self._ending()
        await super().shutdown(sockets)


def serve(
    settings: Settings, keys: IdpKeys, platform: Platform | None = None, policies: PolicySet | None = None
) -> None:
    """Serve until SIGTERM or SIGINT. Returns when every open request has ended and the store is closed.

    Args:
        settings: checked already.
        keys: the five private keys.
        platform: the platform whose workload tokens count, if any.
        policies: the set that decides on delegations; None: the shipped set that the settings name.
    """
    app = create_app(settings, keys, platform=platform, policies=policies)
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        ssl_certfile=settings.tls_certificate_file,
        ssl_keyfile=settings.tls_key_file,
        loop="asyncio",  # in any environment: uvloop comes with packages that ask for it
        http="h11",
        ws="none",
        lifespan="on",
        access_log=False,
        log_level="warning",
        server_header=False,
        proxy_headers=False,
        h11_max_incomplete_event_size=HEADER_BYTES,
        timeout_graceful_shutdown=GRACE_S,
    )

    def ending() -> None:
        app.state.provider.epochs.close()  # there is a provider from the start of the application on

    _Announcing(config, port=settings.port, ending=ending).run()

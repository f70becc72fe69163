"""HTTP server behind the edge: the same for identity provider, tool server, gateway and status page."""

from __future__ import annotations

import resource
import sys
from typing import TYPE_CHECKING, Any, Final, cast

import uvicorn

from ztpm.codes.unavailable import unavailable
from ztpm.edge.connection import PlacedConnection
from ztpm.edge.listener import Listener, bound
from ztpm.edge.places import Bounds, Places

if TYPE_CHECKING:
    import asyncio
    import socket

    from starlette.types import ASGIApp

    from ztpm.edge.places import ConnectionPlace

HEADER_BYTES: Final = 32_768
"""Headers that are read: a token of 16 KiB, its proof, and room."""
KEEP_ALIVE_S: Final = 5
"""Time for which a connection waits for its next request."""
NOT_STARTED: Final = 1
"""Exit status where the application itself cannot start; it has said why."""


class EdgeServer(uvicorn.Server):
    """Server whose listeners have places, deadlines and bounds.

    Args:
        app: served app.
        host, port: address to listen at; a bound socket may be given to `serve` instead.
        bounds: most connections; fewer where the system allows fewer descriptors.
        options: further ones of `uvicorn.Config`, none of which loosens the edge.

    Raises:
        UnavailableError: `CERTIFICATE_UNUSABLE`: certificate or key cannot be had.
    """

    def __init__(
        self, app: ASGIApp, *, host: str = "127.0.0.1", port: int = 0, bounds: Bounds | None = None, **options: Any
    ) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                host=host,
                port=port,
                loop="asyncio",  # in any environment: uvloop comes with packages that ask for it
                http=PlacedConnection,
                ws="none",
                access_log=False,
                log_config=None,  # the process's own log, in which lines repeat once a minute
                server_header=False,
                proxy_headers=False,
                h11_max_incomplete_event_size=HEADER_BYTES,
                timeout_keep_alive=KEEP_ALIVE_S,
                **options,
            )
        )
        self._bounds = bounds or Bounds()
        try:
            self.config.load()
        except OSError as error:
            files = f"{self.config.ssl_certfile}, {self.config.ssl_keyfile}"
            raise unavailable(error, files, code="CERTIFICATE_UNUSABLE") from error

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listens from now on, with as many descriptors as the system allows.

        Raises:
            UnavailableError: `PORT_UNUSABLE`: the address cannot be had.
        """
        await self.lifespan.startup()
        if self.lifespan.should_exit:
            sys.exit(NOT_STARTED)
        try:
            listening = bound(self.config.host, self.config.port) if sockets is None else sockets
        except OSError as error:
            await self.lifespan.shutdown()
            place = f"{self.config.host} port {self.config.port}"
            raise unavailable(error, place, code="PORT_UNUSABLE") from error
        places = Places(self._bounds.within(descriptors()))

        def connection(place: ConnectionPlace) -> PlacedConnection:
            return PlacedConnection(
                place, places, config=self.config, server_state=self.server_state, app_state=self.lifespan.state
            )

        listeners = [Listener(each, places=places, protocol=connection, tls=self.config.ssl) for each in listening]
        self.servers = cast("list[asyncio.Server]", listeners)  # of a server, uvicorn itself uses nothing but its end
        self.started = True


def descriptors() -> int:
    """Most descriptors of this process, raised to what the system allows it."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    return most if most != resource.RLIM_INFINITY else sys.maxsize

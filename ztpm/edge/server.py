"""HTTP server behind the edge: the same for identity provider, tool server, gateway and status page."""

from __future__ import annotations

import asyncio
import resource
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import uvicorn
from uvicorn.config import create_ssl_context

from ztpm.codes.unavailable import unavailable
from ztpm.edge.connection import PlacedConnection
from ztpm.edge.listener import Listener, bound
from ztpm.edge.places import Bounds, Places
from ztpm.edge.tls import PERIOD_TICKS, TlsFiles

if TYPE_CHECKING:
    import socket
    import ssl
    from collections.abc import Callable

    from starlette.types import ASGIApp

    from ztpm.edge.places import ConnectionPlace

HEADER_BYTES: Final = 32_768
"""Headers that are read: a token of 16 KiB, its proof, and room."""
KEEP_ALIVE_S: Final = 5
"""Time for which a connection waits for its next request."""
NO_PASSPHRASE: Final = "-"  # noqa: S105  it is none
"""Passphrase of a key that has none.

Without any, OpenSSL would ask for that of an encrypted one at the terminal.
"""
NOT_STARTED: Final = 1
"""Exit status where the application itself cannot start; it has said why."""


class EdgeServer(uvicorn.Server):
    """Server whose listeners have places, deadlines and bounds.

    Args:
        app: served app.
        host, port: address to listen at; a bound socket may be given to `serve` instead.
        bounds: most connections; fewer where the system allows fewer descriptors.
        check_tls: refuses a new certificate or key that should not be shown, by ValueError.
        tell_tls: is told each second why the files of both are not acted on, or None.
        options: further ones of `uvicorn.Config`, none of which loosens the edge.

    Raises:
        UnavailableError: `CERTIFICATE_UNUSABLE`: certificate or key cannot be had.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        bounds: Bounds | None = None,
        check_tls: Callable[[], object] = lambda: None,
        tell_tls: Callable[[str | None], object] = lambda _: None,
        **options: Any,
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
        self.tls: TlsFiles | None = None
        try:
            self.config.load()
            if self.config.ssl_certfile and self.config.ssl_keyfile:
                self.tls = TlsFiles(
                    Path(self.config.ssl_certfile),
                    Path(self.config.ssl_keyfile),
                    make=self._context,
                    check=check_tls,
                    told=tell_tls,
                )
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

        files = self.tls
        tls = None if files is None else lambda: files.context
        listeners = [Listener(each, places=places, protocol=connection, tls=tls) for each in listening]
        self.servers = cast("list[asyncio.Server]", listeners)  # of a server, uvicorn itself uses nothing but its end
        self.started = True
        if files is not None and threading.current_thread() is threading.main_thread():
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, files.look)

    async def on_tick(self, counter: int) -> bool:
        """Looks at the files of TLS once a second."""
        if self.tls is not None and counter % PERIOD_TICKS == 0:
            self.tls.look()
        return await super().on_tick(counter)

    def _context(self) -> ssl.SSLContext:
        """TLS context of certificate and key as their files are now."""
        config = self.config
        if not config.ssl_certfile:
            raise AssertionError
        return create_ssl_context(
            config.ssl_certfile,
            config.ssl_keyfile,
            config.ssl_keyfile_password or NO_PASSPHRASE,
            config.ssl_version,
            config.ssl_cert_reqs,
            config.ssl_ca_certs,
            config.ssl_ciphers,
        )


def descriptors() -> int:
    """Most descriptors of this process, raised to what the system allows it."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    return most if most != resource.RLIM_INFINITY else sys.maxsize

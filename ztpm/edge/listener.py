"""Listener that gives every connection its place before anything is read of it, the TLS handshake included."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable

    from ztpm.edge.places import ConnectionPlace, Places

BACKLOG: Final = 2_048
"""Connections that the kernel keeps until they are accepted.

A caller who finds the queue full tries again only a second later.
"""
AT_ONCE: Final = 64
"""Most connections accepted in a row: then those that are there have their turn."""
HANDSHAKE_S: Final = 5.0
"""Longest TLS handshake."""
RETRY_S: Final = 0.05
"""Pause before the next attempt where the system has no descriptor left."""
INTERNET: Final = frozenset({socket.AF_INET, socket.AF_INET6})
NONE_LEFT: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_LOG: Final = logging.getLogger(__name__)


def bound(host: str, port: int) -> list[socket.socket]:
    """Sockets that listen at every address of the host.

    Raises:
        OSError: one of them cannot be had.
    """
    found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    return [
        socket.create_server(address[:2], family=family, backlog=BACKLOG)
        for family, address in dict.fromkeys((each[0], each[4]) for each in found)
    ]


class Listener:
    """Acceptor of one listening socket.

    Args:
        listening: bound socket; closed with the listener.
        places: places of the connections.
        protocol: makes the protocol of a connection that has its place.
        tls: tells the context of the next TLS connection; None: there is no TLS.
    """

    def __init__(
        self,
        listening: socket.socket,
        *,
        places: Places,
        protocol: Callable[[ConnectionPlace], asyncio.Protocol],
        tls: Callable[[], ssl.SSLContext] | None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._socket = listening
        self._places = places
        self._protocol = protocol
        self._tls = tls
        self._entering: set[asyncio.Task[None]] = set()
        listening.setblocking(False)  # noqa: FBT003 - as socket has it
        listening.listen(BACKLOG)
        self._listen()

    def close(self) -> None:
        """Accepts nothing more."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()
            for task in self._entering:
                task.cancel()

    async def wait_closed(self) -> None:
        """Waits for connections that were on their way in."""
        await asyncio.gather(*self._entering, return_exceptions=True)

    def _listen(self) -> None:
        if self._socket.fileno() >= 0:
            self._loop.add_reader(self._socket, self._accept)

    def _accept(self) -> None:
        for _ in range(AT_ONCE):
            try:
                accepted, peer = self._socket.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno not in NONE_LEFT:
                    raise
                _LOG.warning("no connection can be accepted: %s", error.strerror)
                self._places.spare()
                self._loop.remove_reader(self._socket)
                self._loop.call_later(RETRY_S, self._listen)
                return
            accepted.setblocking(False)  # noqa: FBT003 - as socket has it
            if accepted.family in INTERNET:
                # An answer of two parts would wait for the caller's delayed acknowledgement (40 ms) between them; the
                # loop itself sees to it only where a socket was made with its protocol's number.
                accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._admit(accepted, str(peer[0]) if peer else "")

    def _admit(self, accepted: socket.socket, address: str) -> None:
        ended = self._places.ended
        place = self._places.take(address, lambda: None)
        if self._places.ended > ended:
            _LOG.warning("strangers' connections made room for others, the newest from %s", address)
        if place is None:
            accepted.close()
            return
        task = self._loop.create_task(self._enter(accepted, place))
        place.end = lambda: _cancel(task)
        self._entering.add(task)
        task.add_done_callback(lambda task: self._entered(task, accepted, place))

    async def _enter(self, accepted: socket.socket, place: ConnectionPlace) -> None:
        await self._loop.connect_accepted_socket(
            lambda: self._protocol(place),
            accepted,
            ssl=None if self._tls is None else self._tls(),
            ssl_handshake_timeout=HANDSHAKE_S if self._tls else None,
        )

    def _entered(self, task: asyncio.Task[None], accepted: socket.socket, place: ConnectionPlace) -> None:
        """Ends a connection that did not come in: its caller went away, spoke no TLS, or made room for another."""
        self._entering.discard(task)
        if task.cancelled() or task.exception() is not None:
            accepted.close()
            self._places.leave(place)


def _cancel(task: asyncio.Task[None]) -> None:
    task.cancel()

"""Listening and talking: one thread for each connection, and writes that never wait for a slow reader."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_CONNECTIONS: Final = 32  # on one port; the next is closed at once
MAX_BACKLOG: Final = 16 * 1024 * 1024  # bytes a reader may fall behind
PATIENCE_S: Final = 10.0  # a client that does not read for this long is disconnected, as by the real controller
CHUNK: Final = 65_536
LOSSY_BUFFER: Final = 65_536


class Connection:
    """One accepted socket. `send` may be called from any thread and never blocks.

    Args:
        sock: the accepted socket.
        lossy: whether what a slow reader cannot take is dropped, whole messages at a time, instead of ending it.
    """

    def __init__(self, sock: socket.socket, *, lossy: bool) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if lossy:  # a reader that never reads is noticed early, and costs nothing from then on
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LOSSY_BUFFER)
        self._socket = sock
        self._lossy = lossy
        self._lock = threading.Lock()
        self._backlog = bytearray()
        self._behind_since = 0.0
        self.open = True

    def receive(self) -> bytes:
        """What arrived; empty when the peer, or anyone here, closed the connection."""
        with suppress(OSError):
            return self._socket.recv(CHUNK)
        return b""

    def send(self, message: bytes) -> None:
        """`message` goes out now, or when the reader has caught up and `flush` is called."""
        with self._lock:
            if not self.open:
                return
            if self._backlog:
                if not self._lossy:
                    self._backlog += message
                self._push()
                return
            sent = self._try(message)
            if sent < len(message) and (sent or not self._lossy):  # a message that has begun must be finished
                self._backlog += message[sent:]
                self._behind_since = time.monotonic()

    def flush(self) -> None:
        """What waited goes out as far as it can; a reader that is too far or too long behind is disconnected."""
        if self._backlog:
            with self._lock:
                self._push()

    @property
    def behind(self) -> bool:
        """Whether the reader has not taken all it was sent."""
        return bool(self._backlog)

    def close(self) -> None:
        """No more is received or sent; a thread waiting in `receive` returns."""
        self.open = False
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def release(self) -> None:
        """The socket itself is given back; called by the thread that received from it."""
        self.close()
        with self._lock:
            self._socket.close()

    def _push(self) -> None:
        sent = self._try(self._backlog)
        if sent:
            del self._backlog[:sent]
            self._behind_since = time.monotonic()
        late = time.monotonic() - self._behind_since > PATIENCE_S
        if not self._lossy and self._backlog and (late or len(self._backlog) > MAX_BACKLOG):
            self.close()

    def _try(self, message: bytes | bytearray) -> int:
        try:
            return self._socket.send(message, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return 0
        except OSError:
            self.close()
            return len(message)


class Port:
    """One listening port and its connections.

    Args:
        host: IPv4 address to listen on.
        number: the port.
        serve: talks to one connection until it is over; runs in a thread of its own.
        lossy: see `Connection`.

    Raises:
        OSError: the port cannot be had; its `filename` names host and port.
    """

    def __init__(self, host: str, number: int, serve: Callable[[Connection], None], *, lossy: bool = False) -> None:
        self.number = number
        self._serve = serve
        self._lossy = lossy
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._connections: set[Connection] = set()
        self._lock = threading.Lock()
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((host, number))
            self._socket.listen()
        except OSError as error:
            self._socket.close()
            raise OSError(error.errno, error.strerror, f"{host}:{number}") from error
        self._thread = threading.Thread(target=self._accept, name=f"port-{number}", daemon=True)

    def start(self) -> None:
        """Accepts from now on."""
        self._thread.start()

    def connections(self) -> tuple[Connection, ...]:
        """Those open now."""
        with self._lock:
            return tuple(self._connections)

    def close(self) -> None:
        """Accepts no more and closes every connection."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        for connection in self.connections():
            connection.close()

    def _accept(self) -> None:
        while True:
            try:
                accepted, _ = self._socket.accept()
            except OSError:
                return
            connection = Connection(accepted, lossy=self._lossy)
            with self._lock:
                full = len(self._connections) >= MAX_CONNECTIONS
                if not full:
                    self._connections.add(connection)
            if full:
                connection.release()
                continue
            threading.Thread(target=self._talk, args=(connection,), name=f"client-{self.number}", daemon=True).start()

    def _talk(self, connection: Connection) -> None:
        try:
            self._serve(connection)
        finally:
            with self._lock:
                self._connections.discard(connection)
            connection.release()

"""Listening and talking: one thread for each connection, and writes that never wait for a slow reader."""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_CONNECTIONS: Final = 32  # on one port; the next is closed at once
MAX_BACKLOG: Final = 16 * 1024 * 1024  # bytes a reader may fall behind
PATIENCE_S: Final = 10.0  # a client that does not read for this long is disconnected, as by the real controller
CHUNK: Final = 65_536
LOSSY_BUFFER: Final = 65_536
TEAR_S: Final = 0.002  # between the halves of a torn message: one tick


@dataclass(slots=True)
class Delivery:
    """Delivery of a controller's messages: at once and whole, until a fault is asked for.

    Attributes:
        delay_s: delay of every message, seconds.
        torn: whether every message comes in two halves, a tick apart.
        bytes_per_tick: most bytes of each connection in a tick; None for no bound.
        touched: whether any of these faults was ever asked for.
    """

    delay_s: float = 0.0
    torn: bool = False
    bytes_per_tick: int | None = None
    touched: bool = False

    @property
    def sound(self) -> bool:
        """True where no fault is set."""
        return not self.delay_s and not self.torn and self.bytes_per_tick is None


class Connection:
    """One accepted socket. `send` may be called from any thread and never blocks.

    Args:
        sock: the accepted socket.
        delivery: read at every message.
        lossy: whether messages that a slow reader cannot take are dropped, whole ones at a time, instead of ending it.
    """

    def __init__(self, sock: socket.socket, delivery: Delivery, *, lossy: bool) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if lossy:  # a reader that never reads is noticed early, and costs nothing from then on
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LOSSY_BUFFER)
        self._socket = sock
        self._lossy = lossy
        self._lock = threading.Lock()
        self._backlog = bytearray()
        self._behind_since = 0.0
        self._delivery = delivery
        self._waiting: deque[tuple[float, bytes]] = deque()  # messages that a fault holds back, and their time
        self.open = True

    def receive(self) -> bytes:
        """Bytes that arrived; empty when the peer, or this side, closed the connection."""
        with suppress(OSError):
            return self._socket.recv(CHUNK)
        return b""

    def send(self, message: bytes) -> None:
        """`message` goes out now, or when the reader has caught up and `flush` is called."""
        with self._lock:
            if not self.open:
                return
            delivery = self._delivery
            if delivery.sound and not self._waiting:
                self._send(message)
                return
            due, half = time.monotonic() + delivery.delay_s, len(message) // 2 if delivery.torn else 0
            if half:
                self._waiting.append((due, message[:half]))
            self._waiting.append((due + TEAR_S if half else due, message[half:]))

    def deliver(self) -> None:
        """Sends the messages that a fault held back, as far as they are due; called once a tick."""
        with self._lock:
            left = self._delivery.bytes_per_tick or MAX_BACKLOG
            now = time.monotonic()
            while self._waiting and self._waiting[0][0] <= now and left > 0:
                due, message = self._waiting.popleft()
                if len(message) > left:
                    self._waiting.appendleft((due, message[left:]))
                self._send(message[:left])
                left -= len(message)

    def _send(self, message: bytes) -> None:
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
        """Sends waiting bytes as far as possible.

        A reader that is too far or too long behind is disconnected.
        """
        if self._backlog:
            with self._lock:
                self._push()

    @property
    def behind(self) -> bool:
        """True where the reader has not taken, or has not been given, all that was sent."""
        return bool(self._backlog) or self.starved

    @property
    def starved(self) -> bool:
        """True where a fault lets fewer bytes out than are sent; newer messages are skipped then."""
        return self._delivery.bytes_per_tick is not None and bool(self._waiting)

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
        delivery: see `Connection`.
        lossy: see `Connection`.

    Raises:
        OSError: the port cannot be had; its `filename` names host and port.
    """

    def __init__(
        self, host: str, number: int, serve: Callable[[Connection], None], delivery: Delivery, *, lossy: bool = False
    ) -> None:
        self.number = number
        self._serve = serve
        self._delivery = delivery
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
        """Connections that are open now."""
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
            connection = Connection(accepted, self._delivery, lossy=self._lossy)
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

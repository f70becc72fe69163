"""Sockets that a program opens, read and written in the tick, never waited for.

A read that is not complete asks again in the next tick. All sockets of a program are closed with it.
"""

from __future__ import annotations

import ipaddress
import select
import socket
from contextlib import suppress
from typing import Final

MOST_SOCKETS: Final = 16
"""Sockets of one program; the vendor's client library opens three."""
MAX_HELD: Final = 64 * 1024
"""Bytes that wait to be read, or to go out."""
CHUNK: Final = 65_536


class ProgramSocket:
    """One TCP connection that a program began.

    Args:
        host: numeric IPv4 address; the simulator resolves no names.
        port: TCP port.

    Raises:
        ValueError: `host` is no IPv4 address, or `port` no port.
    """

    def __init__(self, host: str, port: int) -> None:
        address = str(ipaddress.IPv4Address("127.0.0.1" if host == "localhost" else host))
        if not 0 < port < 65536:
            raise ValueError(f"{port} is no TCP port")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.settimeout(0.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._arrived = bytearray()
        self._leaving = bytearray()
        self.connected = False
        self.over = False
        with suppress(BlockingIOError, OSError):  # what came of it is asked for in `ready`
            self._socket.connect((address, port))

    def ready(self) -> bool:
        """True once the connection stands; a connection that was refused is `over`."""
        if not self.connected and not self.over:
            _, writable, _ = select.select([], [self._socket], [], 0)
            if writable:
                self.over = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0
                self.connected = not self.over
        return self.connected and not self.over

    def take(self, count: int) -> bytes | None:
        """The next `count` bytes, once that many have arrived."""
        self._receive()
        if len(self._arrived) < count:
            return None
        taken = bytes(self._arrived[:count])
        del self._arrived[:count]
        return taken

    def take_to(self, end: bytes) -> bytes | None:
        """Bytes up to and with the next `end`, once it has arrived; all that is there where `end` is empty."""
        self._receive()
        if not end:
            return self.take(len(self._arrived)) if self._arrived else None
        at = self._arrived.find(end)
        return None if at < 0 else self.take(at + len(end))

    def send(self, message: bytes) -> bool:
        """True where the connection stands and `message` goes out; a peer that reads nothing ends it."""
        if not self.ready():
            return False
        self._leaving += message
        self._push()
        if len(self._leaving) > MAX_HELD:
            self.close()
        return not self.over

    def close(self) -> None:
        """Ends the connection."""
        self.over = True
        self._socket.close()

    def _receive(self) -> None:
        if not self.ready():
            return
        self._push()
        while not self.over and len(self._arrived) < MAX_HELD:
            try:
                received = self._socket.recv(CHUNK)
            except BlockingIOError:
                return
            except OSError:
                received = b""
            if not received:
                self.over = True
            self._arrived += received

    def _push(self) -> None:
        if self._leaving and not self.over:
            try:
                del self._leaving[: self._socket.send(self._leaving)]
            except BlockingIOError:
                return
            except OSError:
                self.over = True

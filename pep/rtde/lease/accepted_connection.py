"""Connection of a client to one of the ports, before and during its service by a line."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from pep.rtde.robot.connections import UNREAD_BYTES
from pep.rtde.robot.quick_ack import acknowledge

if TYPE_CHECKING:
    from pep.rtde.robot.connections import ProgramConnection

CHUNK: Final = 65_536


class AcceptedConnection(asyncio.Protocol):
    """One connection, also the way back to its client.

    Bytes that come before its service are kept.
    """

    def __init__(self) -> None:
        self._line: ProgramConnection | None = None
        self._early: list[bytes] = []
        self._left = False

    def begin(self, line: ProgramConnection) -> None:
        """Hands the connection to `line` from now on."""
        self._line = line
        early, self._early = self._early, []
        for content in early:
            line.received(content)
        if self._left:
            line.left()
        else:
            self._transport.resume_reading()

    def send(self, content: bytes) -> None:
        """Sends whole frames, dropped whole where the client does not read."""
        if self._transport.get_write_buffer_size() < UNREAD_BYTES:
            self._transport.write(content)

    def close(self) -> None:
        """Closes the connection as the controller would."""
        self._transport.close()

    def tell(self, text: str) -> None:
        """Drops the text: there is no listener beside the connection."""

    # ---- asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Takes the new connection."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(high=UNREAD_BYTES)

    def data_received(self, data: bytes) -> None:
        """Passes the client's bytes on, or keeps them."""
        if self._line is not None:
            self._line.received(data)
        else:
            self._early.append(data)
            self._transport.pause_reading()
        acknowledge(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Tells the line that the client has gone."""
        self._left = True
        try:
            if exc is not None:
                self._hear_out()
        finally:
            if self._line is not None:
                self._line.left()

    def _hear_out(self) -> None:
        """Reads the last bytes of a client that says "stop" and closes without having read.

        A write that fails on such a connection ends it for asyncio, with its unread input.
        """
        with suppress(OSError), self._transport.get_extra_info("socket").dup() as rest:
            rest.settimeout(0.0)
            while content := rest.recv(CHUNK):
                self.data_received(content)

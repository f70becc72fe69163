"""A connection that a client has made to one of the ports, until and while somebody serves it."""

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
    """One connection; also the way back to its client. What comes before it is served is kept."""

    def __init__(self) -> None:
        self._line: ProgramConnection | None = None
        self._early: list[bytes] = []
        self._left = False

    def begin(self, line: ProgramConnection) -> None:
        """`line` serves it from now on."""
        self._line = line
        early, self._early = self._early, []
        for content in early:
            line.received(content)
        if self._left:
            line.left()
        else:
            self._transport.resume_reading()

    def send(self, content: bytes) -> None:
        """Whole frames, dropped whole where nobody reads."""
        if self._transport.get_write_buffer_size() < UNREAD_BYTES:
            self._transport.write(content)

    def close(self) -> None:
        """As the controller would."""
        self._transport.close()

    def tell(self, text: str) -> None:
        """Nobody listens beside the connection."""

    # ---- asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection is there."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(high=UNREAD_BYTES)

    def data_received(self, data: bytes) -> None:
        """What the client says."""
        if self._line is not None:
            self._line.received(data)
        else:
            self._early.append(data)
            self._transport.pause_reading()
        acknowledge(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """The client has gone."""
        self._left = True
        try:
            if exc is not None:
                self._hear_out()
        finally:
            if self._line is not None:
                self._line.left()

    def _hear_out(self) -> None:
        """What was said last is heard: who says "stop" and goes, without having read, ends the connection before it.

        A write that fails on such a connection ends it for asyncio, whatever has come on it by then.
        """
        with suppress(OSError), self._transport.get_extra_info("socket").dup() as rest:
            rest.settimeout(0.0)
            while content := rest.recv(CHUNK):
                self.data_received(content)

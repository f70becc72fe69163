"""The controller's ports as everybody else sees them: what has no lease gets state and stop.

Each connection is ended here and begun anew at the robot; nothing goes through as it came.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from pep.rtde.lines import PORTS, PRIMARY, READ_ONLY, REALTIME, RTDE, SECONDARY, UNREAD_BYTES, Upstream
from pep.rtde.messages import WireError
from pep.rtde.relay import StateRelay
from policies.reasons import Reason

if TYPE_CHECKING:
    from pep.rtde.lines import Back, Line, Ports

CONNECTIONS: Final = 64
"""Strangers at once, on all ports together."""


class StatePort:
    """Serves RTDE without a lease.

    Args:
        back: the way back to the client.
    """

    def __init__(self, back: Back) -> None:
        self._back = back
        self._relay = StateRelay()
        self.robot = Upstream(self._answered, back.close)

    def received(self, content: bytes) -> None:
        """The client sent these bytes."""
        try:
            said = self._relay.asked(content)
        except WireError:
            self._end()
            return
        if said.to_robot:
            self.robot.send(said.to_robot)
        if said.to_client:
            self._back.send(said.to_client)

    def left(self) -> None:
        """The client has gone."""
        self.robot.close()

    def _answered(self, content: bytes) -> None:
        try:
            said = self._relay.answered(content)
        except WireError:
            self._end()
            return
        if said.to_client:
            self._back.send(said.to_client)

    def _end(self) -> None:
        self.robot.close()
        self._back.close()


class StreamPort:
    """Serves a stream of states; nothing that the client says is heard.

    Args:
        back: the way back to the client.
    """

    def __init__(self, back: Back) -> None:
        self.robot = Upstream(back.send, back.close)

    def received(self, content: bytes) -> None:
        """Programs come this way: none without a lease."""

    def left(self) -> None:
        """The client has gone."""
        self.robot.close()


class StatePorts:
    """What anybody gets: `pep.rtde.lines.Ports` without a lease.

    Args:
        robot: host of the controller.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot

    async def open(self, lease: object, port: int, back: Back) -> Line | Reason:  # noqa: ARG002 - the port's own form
        """A connection to that port."""
        line: StatePort | StreamPort
        if port == RTDE:
            line = StatePort(back)
        elif port in (PRIMARY, SECONDARY, REALTIME, *READ_ONLY):
            line = StreamPort(back)
        else:
            return Reason.NOT_GRANTED
        return await line.robot.reach(self._robot, port) or line


class Gateway:
    """Listens where the controller would.

    Args:
        ports: what a connection without a lease is opened to.
    """

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._servers: list[asyncio.Server] = []
        self.guests: set[_Guest] = set()

    async def listen(self, host: str) -> None:
        """From now on.

        Raises:
            OSError: an address cannot be had.
        """
        loop = asyncio.get_running_loop()
        for port in PORTS:
            self._servers.append(
                await loop.create_server(lambda port=port: _Guest(self, self._ports, port), host, port)  # type: ignore[misc]
            )

    def close(self) -> None:
        """Nobody is served any more."""
        for server in self._servers:
            server.close()
        for guest in tuple(self.guests):
            guest.close()


class _Guest(asyncio.Protocol):
    """A client without a lease; also its own way back."""

    def __init__(self, gateway: Gateway, ports: Ports, port: int) -> None:
        self._gateway = gateway
        self._ports = ports
        self._port = port
        self._line: Line | None = None
        self._early: list[bytes] = []
        self._opening: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if len(self._gateway.guests) >= CONNECTIONS:
            transport.abort()
            return
        self._gateway.guests.add(self)
        self._opening = asyncio.get_running_loop().create_task(self._open())

    async def _open(self) -> None:
        line = await self._ports.open(None, self._port, self)
        if isinstance(line, Reason):
            self._transport.abort()
        elif self._transport.is_closing():
            line.left()
        else:
            self._line = line
            self._transport.resume_reading()
            for content in self._early:
                line.received(content)

    def data_received(self, data: bytes) -> None:
        if self._line is not None:
            self._line.received(data)
        else:
            self._early.append(data)
            self._transport.pause_reading()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        self._gateway.guests.discard(self)
        if self._line is not None:
            self._line.left()

    def send(self, content: bytes) -> None:
        """Whole frames, dropped whole where nobody reads."""
        if self._transport.get_write_buffer_size() < UNREAD_BYTES:
            self._transport.write(content)

    def close(self) -> None:
        """As the controller would."""
        self._transport.close()

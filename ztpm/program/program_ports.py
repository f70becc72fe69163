"""Ports of the controller for one program: fixed numbers, on an address of its own, carried in its lease.

An unmodified ur_rtde program connects here as if this were the robot. Only processes of one user are let in: the
address is on this machine, and a user id is one domain of trust (SECURITY.md).
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from pep.rtde.lease.accepted_connection import AcceptedConnection
from pep.rtde.lease.lease_connection import LeaseConnection
from pep.rtde.lease.lease_messages import Bytes, Closed, LeaseMessageError, Open, Opened, OpenRefused, RefusalNotice
from pep.rtde.robot.connections import GONE, PORTS
from pep.rtde.wire.client_texts import told
from policies.words.reason_table import Reason
from ztpm.base.peer import user_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.proof.session_frames import Session
    from pep.base.ports import Clock
    from pep.rtde.lease.lease import LeaseEnding
    from pep.rtde.lease.lease_messages import Word


class ProgramPorts:
    """The ports, and the carriage behind them.

    Args:
        session: the program's end of it.
        lease_id: of the lease.
        clock: both clocks.
        user: the id of the one user whose processes may connect.
        ended: is told once when the lease is over; every connection is closed then.
        told: is given each reason for which the gateway has refused something, a line of text.
    """

    def __init__(
        self,
        session: Session,
        lease_id: bytes,
        *,
        clock: Clock,
        user: int,
        ended: Callable[[LeaseEnding], None],
        told: Callable[[str], None],
    ) -> None:
        self._lease_id = lease_id
        self._user = user
        self._over = ended
        self._told = told
        self._carrier = LeaseConnection(
            session, asking=True, clock=clock, heard=self._heard, ended=self._ended, flowing=self._flow
        )
        self._lines: dict[int, _Connection] = {}
        self._flowing = True
        self._servers: list[asyncio.Server] = []

    async def begin(self, *, gateway: tuple[str, int], host: str, ports: tuple[int, ...] = PORTS) -> None:
        """Carries the lease to the gateway, and listens.

        Args:
            gateway: host and port of its carriages.
            host: address on this machine.
            ports: to listen on; each is that of the controller.

        Raises:
            OSError: the gateway cannot be reached, or an address cannot be had.
        """
        loop = asyncio.get_running_loop()
        for port in ports:
            self._servers.append(await loop.create_server(lambda port=port: _Connection(self, port), host, port))  # type: ignore[misc]
        transport, _ = await loop.create_connection(lambda: _First(self._lease_id, self._carrier), *gateway)
        assert isinstance(transport, asyncio.Transport)

    def close(self) -> None:
        """Gives the lease back."""
        self._carrier.close()

    # ---- the program's connections

    def asks(self, connection: _Connection, port: int) -> int | None:
        """Line of a new connection; None when it may have none."""
        if connection.user() != self._user:
            return None
        try:
            line = self._carrier.lines.free()
            self._carrier.say(Open(line, port))
        except LeaseMessageError:
            return None
        self._lines[line] = connection
        return line

    def says(self, line: int, content: bytes) -> None:
        """Passes on the program's bytes, on an open line."""
        self._carrier.say(Bytes(line, content))

    def leaves(self, line: int) -> None:
        """Notes that the program has closed the line. One that is not open yet is closed when it is."""
        if line in self._carrier.lines.open:
            self._carrier.say(Closed(line))

    @property
    def flowing(self) -> bool:
        """True while the gateway takes more."""
        return self._flowing

    # ---- the carrier's words

    def _heard(self, word: Word) -> None:
        match word:
            case Opened(line):
                self._lines[line].opened()
            case OpenRefused(line, reason):
                self._lines.pop(line).gone()
                # One that is not known here is of a younger gateway.
                self._told(told(Reason(reason)) if reason in Reason.__members__ else reason)
            case RefusalNotice(_, text):
                self._told(text)
            case Bytes(line, content):
                self._lines[line].send(content)
            case Closed(line):
                self._lines.pop(line).gone()
                if line in self._carrier.lines.leaving:
                    self._carrier.say(Closed(line))
            case _:
                pass

    def _flow(self, flowing: bool) -> None:  # noqa: FBT001 - the carrier's callback
        self._flowing = flowing
        for connection in self._lines.values():
            connection.pace()

    def _ended(self, ending: LeaseEnding) -> None:
        for server in self._servers:
            server.close()
        lines, self._lines = self._lines, {}
        for connection in lines.values():
            connection.gone()
        self._over(ending)


class _First(asyncio.Protocol):
    """First message, which names the lease, and leaves the connection to its carrier."""

    def __init__(self, lease_id: bytes, carrier: LeaseConnection) -> None:
        self._lease_id = lease_id
        self._carrier = carrier

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.write(self._lease_id)
        transport.set_protocol(self._carrier)
        self._carrier.connection_made(transport)


class _Connection(AcceptedConnection):
    """One connection of the program to one port."""

    def __init__(self, ports: ProgramPorts, port: int) -> None:
        super().__init__()
        self._ports = ports
        self._port = port
        self._number: int | None = None

    def user(self) -> int | None:
        """User of the process at the other end."""
        return user_of(self._transport.get_extra_info("socket"))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._number = self._ports.asks(self, self._port)
        if self._number is None:
            self._transport.abort()

    def opened(self) -> None:
        """Opens the connection for bytes in both directions."""
        assert self._number is not None
        self.begin(_Leased(self._ports, self._number))
        self.pace()

    def pace(self) -> None:
        """Reads as long as the gateway takes more."""
        if self._line is not None and not self._transport.is_closing():
            if self._ports.flowing:
                self._transport.resume_reading()
            else:
                self._transport.pause_reading()

    def gone(self) -> None:
        """Closes the connection: the port has closed it, or the lease is over.

        A client with unread bytes does not get the rest.
        """
        self.begin(GONE)
        if self._transport.get_write_buffer_size():
            self._transport.abort()
        else:
            self._transport.close()


class _Leased:
    """Open line of the lease."""

    def __init__(self, ports: ProgramPorts, number: int) -> None:
        self._ports = ports
        self._number = number

    def received(self, content: bytes) -> None:
        """Carries the bytes to the gateway."""
        self._ports.says(self._number, content)

    def left(self) -> None:
        """Tells the gateway that the client has left."""
        self._ports.leaves(self._number)

"""Ports of the controller for one program: fixed numbers, on an address of its own, carried in its lease.

An unmodified ur_rtde program connects here as if this were the robot. Only processes of one user are let in: the
address is on this machine, and a user id is one domain of trust (SECURITY.md). When the lease is over the connections
of RTDE stay, that of the commands for a moment, the others until the program closes them ([LSD-12]).
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from pep.rtde.lease.accepted_connection import AcceptedConnection
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.lease.lease_connection import LeaseConnection
from pep.rtde.lease.lease_messages import Bytes, Closed, LeaseMessageError, Open, Opened, OpenRefused, RefusalNotice
from pep.rtde.robot.connections import GONE, LEASED_PORTS, RTDE
from pep.rtde.wire.client_texts import told
from policies.words.reason_table import Reason
from ztpm.base.peer import user_of
from ztpm.program.last_state import LastState

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.proof.session_frames import Session
    from pep.base.ports import Clock
    from pep.rtde.lease.lease_messages import Word

REPEAT_S: Final = 0.1
"""Ours: time between two repetitions of the last state; ur_rtde gives a silent connection up after 2.5 s."""
FAILING_S: Final = 2.0
"""Ours: time for which commands of a program fail by the state, before their connection ends."""


class ProgramPorts:
    """The ports, and the carriage behind them.

    Args:
        session: the program's end of it.
        lease_id: of the lease.
        clock: both clocks.
        user: the id of the one user whose processes may connect.
        ended: is told once when the lease is over; no connection leads to the gateway then.
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
        self._staying: set[_Connection] = set()
        self._none_stays = asyncio.Event()

    async def begin(self, *, gateway: tuple[str, int], host: str, ports: tuple[int, ...] = LEASED_PORTS) -> None:
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

    @property
    def staying(self) -> bool:
        """True while the lease is over and the program still has connections."""
        return bool(self._staying)

    async def all_left(self) -> None:
        """Returns once the lease is over and the program has closed its last connection."""
        await self._none_stays.wait()

    # ---- the program's connections

    def gone(self, connection: _Connection) -> None:
        """Forgets a connection that stayed after the lease."""
        self._staying.discard(connection)
        if not self._staying:
            self._none_stays.set()

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
        broken = ending is LeaseEnding.MALFORMED
        # A program that has given its lease back need not hear of its end.
        given_back = ending in (LeaseEnding.CLOSED, LeaseEnding.LEFT)
        for connection in lines.values():
            if not broken and connection.stays(also_for_commands=given_back):
                self._staying.add(connection)
            else:
                connection.gone()
        if not self._staying:
            self._none_stays.set()
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
        self.state = LastState() if port == RTDE else None
        self._repeating: asyncio.TimerHandle | None = None

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
        self.begin(_Leased(self._ports, self._number, self.state))
        self.pace()

    def send(self, content: bytes) -> None:
        """Sends what the gateway says."""
        if self.state is not None:
            self.state.answered(content)
        super().send(content)

    def stays(self, *, also_for_commands: bool) -> bool:
        """True where the connection goes on after the lease, with the robot's last state and the client's farewell.

        Args:
            also_for_commands: one of commands goes on as long as any; else for `FAILING_S`.
        """
        state = self.state
        if state is None or not state.stays or self._number is None or self._transport.is_closing():
            return False
        self.begin(_Unleased(self, self._ports, state))
        self._repeat(state.repeated())
        if state.commands and not also_for_commands:
            asyncio.get_running_loop().call_later(FAILING_S, self.close)
        return True

    def reply(self, answer: bytes) -> None:
        """Sends an answer of our own."""
        super().send(answer)

    def _repeat(self, said: bytes) -> None:
        if not self._transport.is_closing():
            super().send(said)
            self._repeating = asyncio.get_running_loop().call_later(REPEAT_S, self._repeat, said)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._repeating is not None:
            self._repeating.cancel()
        super().connection_lost(exc)

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

    def __init__(self, ports: ProgramPorts, number: int, state: LastState | None) -> None:
        self._ports = ports
        self._number = number
        self._state = state

    def received(self, content: bytes) -> None:
        """Carries the bytes to the gateway."""
        self._ports.says(self._number, content)
        if self._state is not None:
            self._state.said(content)

    def left(self) -> None:
        """Tells the gateway that the client has left."""
        self._ports.leaves(self._number)


class _Unleased:
    """Line after the lease: nothing goes to the robot any more."""

    def __init__(self, connection: _Connection, ports: ProgramPorts, state: LastState) -> None:
        self._connection = connection
        self._ports = ports
        self._state = state

    def received(self, content: bytes) -> None:
        """Answers a client that leaves."""
        answer = self._state.farewell(content)
        if answer:
            self._connection.reply(answer)

    def left(self) -> None:
        """Notes that the client has left."""
        self._ports.gone(self._connection)

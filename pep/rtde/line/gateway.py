"""Ports of the controller for clients without a lease, who get state and stop.

Each connection is ended here and begun anew at the robot; nothing goes through as it came.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import TYPE_CHECKING, Final, assert_never

from pep.rtde.command.command_values import StopJ, StopL
from pep.rtde.lease.accepted_connection import AcceptedConnection
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.line.relay import StateRelay
from pep.rtde.robot.connections import DASHBOARD, PORTS, PRIMARY, READ_ONLY, REALTIME, RTDE, SECONDARY, Conversation
from pep.rtde.script.statements import StraightLine
from pep.rtde.script.straight_line import straight_line
from pep.rtde.script.urscript import ProgramStream, ScriptError
from pep.rtde.wire.dashboard_grammar import MAX_LINE, LineClass, parse_line
from pep.rtde.wire.frame_splitter import LENGTH, FrameSplitter, LengthError
from pep.rtde.wire.messages import WireError
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.rtde.robot import connections
    from pep.rtde.robot.connections import Ports, ReplyChannel
    from pep.rtde.wire.dashboard_grammar import DashboardLine

MAX_STOP: Final = 4_096
"""Most characters of a program that only stops."""
STOP_PROGRAM: Final = "stop program"
"""Stop program of UR's own client on the primary port."""
FRAME_BYTES: Final = 65_536
"""Largest frame of a stream of states.

The controller's longest has some 1.5 KiB, a popup's text may have more.
"""
ANSWER_BYTES: Final = 4_096
"""Longest answer line of the dashboard."""
GUESTS: Final = 16
"""Most strangers at once on one port.

Each has a connection to the controller, which has other clients too.
"""
LINES: Final = 64
"""Most lines for the dashboard in one piece: each takes time, and no client asks so much before an answer."""
STOPS: Final = 8
"""Most programs in one piece."""
STOPPING: Final = {"stop": StopMeans.DASHBOARD, "pause": StopMeans.REGISTERS, "power off": StopMeans.DASHBOARD}
"""Lines that stop the arm, with the least stop that each must come to."""


class StatePort(Conversation):
    """Server of RTDE without a lease.

    Args:
        back: the way back to the client.
    """

    def __init__(self, back: ReplyChannel) -> None:
        super().__init__(back)
        self._relay = StateRelay()

    def received(self, content: bytes) -> None:
        """Takes bytes of the client."""
        try:
            said = self._relay.asked(content)
        except WireError:
            self.end()
            return
        if said.to_robot:
            self.robot.send(said.to_robot)
        if said.to_client:
            self._back.send(said.to_client)

    def _heard(self, content: bytes) -> None:
        try:
            said = self._relay.answered(content)
        except WireError:
            self.end()
            return
        if said.to_client:
            self._back.send(said.to_client)


class DashboardPort(Conversation):
    """Server of the dashboard without a lease: questions, and lines that end motion or take a notice away.

    Args:
        back: the way back to the client.
        stopping: is told of each stop.
    """

    def __init__(self, back: ReplyChannel, *, stopping: Callable[[StopMeans], None]) -> None:
        super().__init__(back)
        self._stopping = stopping
        self._asked, self._said = bytearray(), bytearray()

    def received(self, content: bytes) -> None:
        """Takes bytes of the client."""
        self._asked += content
        if content.count(b"\n") > LINES:
            self.end()
            return
        while (end := self._asked.find(b"\n")) >= 0:
            line = parse_line(bytes(self._asked[:end]))
            del self._asked[: end + 1]
            if not self._answers(line):
                return
        if len(self._asked) > MAX_LINE:
            self.end()

    def _answers(self, line: DashboardLine | InputRefusal) -> bool:
        """True where the conversation goes on.

        A refusal is told in the dashboard's own way, without the text.
        """
        if isinstance(line, InputRefusal):
            self._back.send(b"could not understand\n")
            return True
        match line.row.line_class:
            case LineClass.ALLOW | LineClass.READ:
                self.robot.send(line.render())
                if line.row.words in STOPPING:
                    self._stopping(STOPPING[line.row.words])
            case LineClass.DECIDE | LineClass.HUMAN | LineClass.DENY:
                self._back.send(f"Failed to execute: {line.row.words}\n".encode())
                self._refused(line.row.words)
            case LineClass.LOCAL:
                self._back.send(b"Disconnected\n")
                self.end()
                return False
            case _:
                assert_never(line.row.line_class)
        return True

    def _refused(self, words: str) -> None:
        """Hook for a refused line of the table."""

    def _heard(self, content: bytes) -> None:
        self._said += content
        end = self._said.rfind(b"\n") + 1
        if end:
            self._back.send(bytes(self._said[:end]))
            del self._said[:end]
        if len(self._said) > ANSWER_BYTES:
            self.end()


class StreamPort(Conversation):
    """Server of a read-only port: its stream of states, frame by frame; the client's bytes are dropped.

    Args:
        back: the way back to the client.
    """

    def __init__(self, back: ReplyChannel) -> None:
        super().__init__(back)
        self._cutter = FrameSplitter(LENGTH, FRAME_BYTES, itself=True)

    def received(self, content: bytes) -> None:
        """Drops the bytes, as a controller does."""

    def _heard(self, content: bytes) -> None:
        try:
            frames = self._cutter.feed(content)
        except LengthError:
            self.end()
            return
        for frame in frames:
            self._back.send(frame)


def only_stops(text: str) -> bool:
    """True for a program that only stops the arm."""
    program = straight_line(text)
    stops = isinstance(program, StraightLine) and all(isinstance(s, StopJ | StopL) for s in program.statements)
    return stops or text.strip() == STOP_PROGRAM


def stop_text(stop_deceleration_rad_s2: float) -> bytes:
    """Program that stops the arm, sent in place of every requested stop."""
    return StraightLine((StopJ(stop_deceleration_rad_s2, asynchronous=False),)).render().encode()


class ScriptPort(StreamPort):
    """Server of a script port without a lease: the stream of states, and programs that only stop the arm.

    Any other ends the connection.

    Args:
        back: the way back to the client.
        stop_deceleration_rad_s2: of the cell's stop model. Every requested stop becomes this one: a
            weaker one would be a motion.
        stopping: is told of each stop.
    """

    def __init__(
        self, back: ReplyChannel, *, stop_deceleration_rad_s2: float, stopping: Callable[[StopMeans], None]
    ) -> None:
        super().__init__(back)
        self._stopping = stopping
        self._programs = ProgramStream(MAX_STOP)
        self._stop = stop_text(stop_deceleration_rad_s2)

    def received(self, content: bytes) -> None:
        """Takes bytes of the client."""
        try:
            programs = self._programs.feed(content.decode("ascii"))
        except (ScriptError, UnicodeDecodeError):
            self.end()
            return
        for text in programs[:STOPS]:
            if not only_stops(text):
                self.end()
                return
            self.robot.send(self._stop)
            self._stopping(StopMeans.PROGRAM)
        if len(programs) > STOPS:
            self.end()


class StatePorts:
    """Ports of clients without a lease: `pep.rtde.robot.connections.Ports` for state and stop.

    Args:
        robot: host of the controller.
        stop_deceleration_rad_s2: of the cell's stop model.
        stopping: is told of each stop that a client sends to the controller, and how hard it is.
    """

    def __init__(
        self, robot: str, *, stop_deceleration_rad_s2: float, stopping: Callable[[StopMeans], None] = lambda _: None
    ) -> None:
        self._robot = robot
        self._deceleration = stop_deceleration_rad_s2
        self._stopping = stopping

    async def open(self, lease: object, port: int, back: ReplyChannel) -> connections.ProgramConnection | Reason:  # noqa: ARG002 - the port's own form
        """Connection to that port."""
        line: StatePort | DashboardPort | ScriptPort | StreamPort
        if port == RTDE:
            line = StatePort(back)
        elif port == DASHBOARD:
            line = DashboardPort(back, stopping=self._stopping)
        elif port in (PRIMARY, SECONDARY, REALTIME):
            line = ScriptPort(back, stop_deceleration_rad_s2=self._deceleration, stopping=self._stopping)
        elif port in READ_ONLY:
            line = StreamPort(back)
        else:
            return Reason.NOT_GRANTED
        return await line.robot.reach(self._robot, port) or line


class Gateway:
    """Listener in the controller's place.

    Args:
        ports: ports for connections without a lease.
    """

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._servers: list[asyncio.Server] = []
        self.guests: list[_Guest] = []

    async def listen(self, host: str) -> None:
        """Listens from now on.

        Raises:
            OSError: an address cannot be had.
        """
        loop = asyncio.get_running_loop()
        for port in PORTS:
            self._servers.append(
                await loop.create_server(lambda port=port: _Guest(self, self._ports, port), host, port)  # type: ignore[misc]
            )

    def admits(self, guest: _Guest) -> bool:
        """True where there is room at the guest's port, if need be after dropping another guest.

        The oldest of the address with most guests goes, where the new one's has fewer.
        """
        there = [other for other in self.guests if other.port == guest.port]
        if len(there) >= GUESTS:
            many = Counter(other.address for other in there)
            address, most = many.most_common(1)[0]
            if most <= many[guest.address] + 1:
                return False
            oldest = next(other for other in there if other.address == address)
            self.guests.remove(oldest)
            oldest.drop()
        self.guests.append(guest)
        return True

    def leaves(self, guest: _Guest) -> None:
        """Removes a guest that has gone."""
        if guest in self.guests:
            self.guests.remove(guest)

    def close(self) -> None:
        """Stops serving."""
        for server in self._servers:
            server.close()
        for guest in tuple(self.guests):
            guest.close()


class _Guest(AcceptedConnection):
    """Client without a lease."""

    def __init__(self, gateway: Gateway, ports: Ports, port: int) -> None:
        super().__init__()
        self._gateway = gateway
        self._ports = ports
        self.port = port
        self.address = ""
        self._opening: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.address = str((transport.get_extra_info("peername") or ("",))[0])
        if not self._gateway.admits(self):
            self.drop()
            return
        self._opening = asyncio.get_running_loop().create_task(self._open())

    async def _open(self) -> None:
        line = await self._ports.open(None, self.port, self)
        if isinstance(line, Reason):
            self.drop()
        else:
            self.begin(line)

    def drop(self) -> None:
        """Aborts the connection, with all unsent bytes."""
        self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._gateway.leaves(self)
        super().connection_lost(exc)

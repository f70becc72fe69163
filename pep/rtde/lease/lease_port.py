"""Port at which the carriage of a lease arrives: its lines are served as connections to the controller's ports.

    first 16 bytes: the lease's id       then: frames of its session (`pep.rtde.lease.lease_connection`)

A connection without the id of a lease, or with that of a carried one, is closed without a word.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from pep.rtde.lease.lease import ID_BYTES, LeaseEnding
from pep.rtde.lease.lease_connection import LeaseConnection
from pep.rtde.lease.lease_messages import Bytes, Closed, Open, Opened, OpenRefused, RefusalNotice
from pep.rtde.robot.connections import GONE
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.rtde.lease.lease import Lease, Leases
    from pep.rtde.lease.lease_messages import Word
    from pep.rtde.robot.connections import Ports, ProgramConnection

PATIENCE_S: Final = 1.0
"""Longest wait for the id."""


class LeasePort:
    """Port for carriages.

    Args:
        leases: of the robot.
        ports: ports that the lines are opened to.
        clock: both clocks.
        begun: is told of a lease whose carriage has come: its program is told from now on how the arm stands.
        ended: is told of a lease that is over, before anything else; the arm is stopped there.
    """

    def __init__(
        self,
        leases: Leases,
        ports: Ports,
        *,
        clock: Clock,
        begun: Callable[[], None],
        ended: Callable[[Lease, LeaseEnding], None],
    ) -> None:
        self._leases = leases
        self._ports = ports
        self._clock = clock
        self._begun = begun
        self._ended = ended
        self._held: _Carried | None = None

    def door(self, *, made: Callable[[asyncio.Transport], None], over: Callable[[], None]) -> asyncio.Protocol:
        """Protocol of a connection that arrives.

        Args:
            made: is told of its transport.
            over: is told, once, that it waits no longer for its id: it is carried, or gone.
        """
        return _Door(self._carry, made, over)

    def end(self, ending: LeaseEnding) -> None:
        """Ends the open lease, if there is one."""
        held, lease = self._held, self._leases.current
        if held is not None:
            held.carrier.close(ending)
        elif lease is not None:
            self.over(lease, ending)

    def look(self) -> None:
        """Ends a lease whose holder has not brought a carriage in time.

        A carried lease looks after itself.
        """
        if self._held is None and self._leases.silent(at_ms=self._clock.monotonic_ms()):
            self.end(LeaseEnding.SILENT)

    def over(self, lease: Lease, ending: LeaseEnding) -> None:
        """Handles the end of that lease's carriage."""
        self._held = None
        if self._leases.end(lease):
            self._ended(lease, ending)

    def _carry(self, lease_id: bytes) -> LeaseConnection | None:
        lease = self._leases.carry(lease_id, at_ms=self._clock.monotonic_ms())
        if lease is None:
            return None
        self._begun()
        self._held = _Carried(lease, self._ports, self, self._clock)
        return self._held.carrier


class _Door(asyncio.Protocol):
    """Connection that has not named its lease yet."""

    def __init__(
        self,
        carry: Callable[[bytes], LeaseConnection | None],
        made: Callable[[asyncio.Transport], None],
        over: Callable[[], None],
    ) -> None:
        self._carry = carry
        self._made = made
        self._over = over
        self._said = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._timer = asyncio.get_running_loop().call_later(PATIENCE_S, transport.abort)
        self._made(transport)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        self._timer.cancel()
        self._over()

    def data_received(self, data: bytes) -> None:
        self._said += data
        if len(self._said) < ID_BYTES:
            return
        self._timer.cancel()
        carrier = self._carry(self._said[:ID_BYTES])
        if carrier is None:
            self._transport.abort()
            return
        self._over()
        self._transport.set_protocol(carrier)
        carrier.connection_made(self._transport)
        if len(self._said) > ID_BYTES:
            carrier.data_received(self._said[ID_BYTES:])


class _Carried:
    """Lease with its carriage and its lines."""

    def __init__(self, lease: Lease, ports: Ports, port: LeasePort, clock: Clock) -> None:
        self._lease = lease
        self._ports = ports
        self._port = port
        self._lines: dict[int, ProgramConnection] = {}
        self._opening: set[asyncio.Task[None]] = set()
        self._ended = False
        self.flowing = True
        self.carrier = LeaseConnection(
            lease.session, asking=False, clock=clock, heard=self._heard, ended=self._over, flowing=self._flow
        )

    def _heard(self, word: Word) -> None:
        match word:
            case Bytes(number, content):
                self._lines[number].received(content)
            case Open(number, port):
                task = asyncio.get_running_loop().create_task(self._open(number, port))
                self._opening.add(task)
                task.add_done_callback(self._opening.discard)
            case Closed(number):
                self._lines.pop(number).left()
                if number in self.carrier.lines.leaving:
                    self.carrier.say(Closed(number))
            case _:
                pass

    async def _open(self, number: int, port: int) -> None:
        back = _Back(self, number)
        served = await self._ports.open(self._lease, port, back)
        if isinstance(served, Reason):
            self.carrier.say(OpenRefused(number, served))
        elif self._ended:
            served.left()
        else:
            self._lines[number] = served
            self.carrier.say(Opened(number))
            back.begin()

    def dropped(self, number: int) -> None:
        """Drops a line whose connection the port has closed: nothing serves the number any more."""
        line = self._lines.pop(number, None)
        if line is not None:
            self._lines[number] = GONE
            self.carrier.say(Closed(number))

    def _flow(self, flowing: bool) -> None:  # noqa: FBT001 - the carrier's callback
        self.flowing = flowing

    def _over(self, ending: LeaseEnding) -> None:
        self._ended = True
        lines, self._lines = self._lines, {}
        with contextlib.ExitStack() as rest:  # each, also where another fails
            for line in lines.values():
                rest.callback(line.left)
            self._port.over(self._lease, ending)


class _Back:
    """Way back of one line. Messages before the line is open are kept until then."""

    def __init__(self, carried: _Carried, number: int) -> None:
        self._carried = carried
        self._number = number
        self._early: list[bytes] | None = []
        self._closed = False

    def begin(self) -> None:
        """Opens the line."""
        early, self._early = self._early or [], None
        for content in early:
            self.send(content)
        if self._closed:
            self._carried.dropped(self._number)

    def send(self, content: bytes) -> None:
        if self._early is not None:
            self._early.append(content)
        elif not self._closed and self._carried.flowing and self._number in self._carried.carrier.lines.open:
            self._carried.carrier.say(Bytes(self._number, content))

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._early is None:
            self._carried.dropped(self._number)

    def tell(self, text: str) -> None:
        # Nothing is kept for an operator who does not read: the program itself has its answer.
        if not self._closed and self._carried.flowing and self._number in self._carried.carrier.lines.open:
            self._carried.carrier.say(RefusalNotice(self._number, text))

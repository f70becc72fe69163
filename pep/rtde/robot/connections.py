"""Parts of a gateway: lines, each from one client to one of the controller's ports, and their ends."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, Protocol

from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.rtde.robot.judge_port import ProgramOwner

DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE = 29999, 30001, 30002, 30003, 30004
GRIPPER: Final = 63352  # Robotiq URCap's socket
READ_ONLY: Final = (30011, 30012, 30013)
PORTS: Final = (DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE, *READ_ONLY)
"""Ports of a UR controller that a client library uses."""
LEASED_PORTS: Final = (*PORTS, GRIPPER)
"""Ports that a program finds in a lease."""
UNREAD_BYTES: Final = 1 << 20
"""Bytes kept for a client that does not read.

More are dropped, whole frames at a time, as by a controller.

ur_rtde never reads what port 30003 sends it 500 times a second.
"""
CONNECT_S: Final = 2.0
LINGER_S: Final = 0.5
"""Longest wait for the other end to close, too."""


def leave(transport: asyncio.Transport) -> None:
    """Ends a connection so that the sent bytes arrive.

    The system tells the end of one with bytes unread as a reset, and who finds that when it writes need not have read
    what came before.
    """
    if transport.can_write_eof() and not transport.is_closing():
        transport.write_eof()
        asyncio.get_running_loop().call_later(LINGER_S, transport.close)
    else:
        transport.close()


class ProgramConnection(Protocol):
    """Server of one line of a program, in place of the controller's port."""

    def received(self, content: bytes) -> None:
        """Takes bytes of the program."""
        ...

    def left(self) -> None:
        """Ends: the program has closed its connection, or its lease is over. Nothing more comes or is taken."""
        ...


class _Gone:
    """Server of a line that the port has closed, until the program closes it too."""

    def received(self, content: bytes) -> None:
        """Drops the bytes."""

    def left(self) -> None:
        """Does nothing: the line is closed already."""


GONE: Final = _Gone()


class ReplyChannel(Protocol):
    """Way back to the program."""

    def send(self, content: bytes) -> None:
        """Sends whole frames of the port's protocol: they are dropped whole while the program does not read."""
        ...

    def close(self) -> None:
        """Ends the connection, as the controller would."""
        ...

    def tell(self, text: str) -> None:
        """Tells the program's operator, beside the connection, the reason of a refusal. Waits for nothing.

        Args:
            text: that fits (`pep.rtde.wire.client_texts`).
        """
        ...


class Ports(Protocol):
    """Ports of the controller, all of them."""

    async def open(self, lease: ProgramOwner | None, port: int, back: ReplyChannel) -> ProgramConnection | Reason:
        """Opens a connection to that port, for the lease's holder or without a lease; or returns the refusal.

        Bytes that are sent before it returns are not lost.
        """
        ...


class Upstream(asyncio.Protocol):
    """Connection of our own to one port of the controller.

    Args:
        heard: is given what comes.
        gone: is told when the controller has closed it.
    """

    def __init__(self, heard: Callable[[bytes], None], gone: Callable[[], None]) -> None:
        self._heard = heard
        self._gone = gone
        self._transport: asyncio.Transport | None = None

    async def reach(self, host: str, port: int) -> Reason | None:
        """Connects; None when it is done."""
        try:
            async with asyncio.timeout(CONNECT_S):
                await asyncio.get_running_loop().create_connection(lambda: self, host, port)
        except (OSError, TimeoutError):
            return Reason.ROBOT_NOT_RUNNING
        return None

    @property
    def connected(self) -> bool:
        """True while there is a connection."""
        return self._transport is not None

    def send(self, content: bytes) -> None:
        """Sends to the controller."""
        if self._transport is not None:
            self._transport.write(content)

    def close(self) -> None:
        """Closes the connection: nothing more is heard, and the sent bytes arrive."""
        transport, self._transport = self._transport, None
        if transport is not None:
            leave(transport)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Takes the new connection."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Takes bytes of the controller."""
        if self._transport is not None:
            self._heard(data)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Handles the end of the connection by the controller."""
        if self._transport is not None:
            self._transport = None
            self._gone()


class Conversation:
    """Line to one port of the controller over a connection of its own.

    Args:
        back: the way back to the client.
    """

    def __init__(self, back: ReplyChannel) -> None:
        self._back = back
        self.robot = Upstream(self._heard, self._gone)

    def left(self) -> None:
        """Ends both: the client has gone."""
        self.robot.close()

    def end(self) -> None:
        """Ends both connections."""
        self.robot.close()
        self._back.close()

    def _heard(self, content: bytes) -> None:
        """Takes bytes of the controller."""
        raise NotImplementedError

    def _gone(self) -> None:
        """Handles the end of the connection by the controller."""
        self._back.close()

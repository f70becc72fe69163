"""What a gateway is made of: lines, each from one client to one of the controller's ports, and where they lead."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, Protocol

from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.rtde.robot.judge_port import ProgramOwner

DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE = 29999, 30001, 30002, 30003, 30004
READ_ONLY: Final = (30011, 30012, 30013)
PORTS: Final = (DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE, *READ_ONLY)
"""Of a UR controller, that a client library has reason to ask for."""
UNREAD_BYTES: Final = 1 << 20
"""So much is kept for a client that does not read; more is dropped, whole frames at a time, as a controller does.

ur_rtde never reads what port 30003 sends it 500 times a second.
"""
CONNECT_S: Final = 2.0
LINGER_S: Final = 0.5
"""Longest wait for the other end to close, too."""


def leave(transport: asyncio.Transport) -> None:
    """End a connection so that what was sent arrives.

    The system tells the end of one with bytes unread as a reset, and who finds that when it writes need not have read
    what came before.
    """
    if transport.can_write_eof() and not transport.is_closing():
        transport.write_eof()
        asyncio.get_running_loop().call_later(LINGER_S, transport.close)
    else:
        transport.close()


class ProgramConnection(Protocol):
    """What serves one line of a program, as one of the controller's ports would."""

    def received(self, content: bytes) -> None:
        """The program sent these bytes."""
        ...

    def left(self) -> None:
        """The program has closed its connection, or its lease is over. Nothing more comes, nothing more is taken."""
        ...


class _Gone:
    """Serves a line that the port has closed, until the program closes it too."""

    def received(self, content: bytes) -> None:
        """Dropped."""

    def left(self) -> None:
        """Already."""


GONE: Final = _Gone()


class ReplyChannel(Protocol):
    """The way back to the program."""

    def send(self, content: bytes) -> None:
        """Whole frames of the port's protocol: they are dropped whole while the program does not read."""
        ...

    def close(self) -> None:
        """End the connection, as the controller would."""
        ...

    def tell(self, text: str) -> None:
        """Beside the connection: why something was refused, for whoever runs the program. Waits for nothing.

        Args:
            text: that fits (`pep.rtde.wire.client_texts`).
        """
        ...


class Ports(Protocol):
    """All ports of the controller."""

    async def open(self, lease: ProgramOwner | None, port: int, back: ReplyChannel) -> ProgramConnection | Reason:
        """A connection to that port, for the holder of that lease or for anybody; or why there is none.

        What is sent before it returns is not lost.
        """
        ...


class Upstream(asyncio.Protocol):
    """Our own connection to one port of the controller.

    Args:
        heard: is given what comes.
        gone: is told when the controller has closed it.
    """

    def __init__(self, heard: Callable[[bytes], None], gone: Callable[[], None]) -> None:
        self._heard = heard
        self._gone = gone
        self._transport: asyncio.Transport | None = None

    async def reach(self, host: str, port: int) -> Reason | None:
        """Connect; None when it is done."""
        try:
            async with asyncio.timeout(CONNECT_S):
                await asyncio.get_running_loop().create_connection(lambda: self, host, port)
        except (OSError, TimeoutError):
            return Reason.ROBOT_NOT_RUNNING
        return None

    @property
    def connected(self) -> bool:
        """Whether there is a connection."""
        return self._transport is not None

    def send(self, content: bytes) -> None:
        """To the controller."""
        if self._transport is not None:
            self._transport.write(content)

    def close(self) -> None:
        """Nothing more is heard, and what was sent arrives."""
        transport, self._transport = self._transport, None
        if transport is not None:
            leave(transport)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection is there."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """What the controller says."""
        if self._transport is not None:
            self._heard(data)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """The controller has ended it."""
        if self._transport is not None:
            self._transport = None
            self._gone()


class Conversation:
    """A line that talks to one port of the controller over a connection of its own.

    Args:
        back: the way back to the client.
    """

    def __init__(self, back: ReplyChannel) -> None:
        self._back = back
        self.robot = Upstream(self._heard, self._gone)

    def left(self) -> None:
        """The client has gone."""
        self.robot.close()

    def end(self) -> None:
        """Both connections."""
        self.robot.close()
        self._back.close()

    def _heard(self, content: bytes) -> None:
        """The controller sent these bytes."""
        raise NotImplementedError

    def _gone(self) -> None:
        """The controller has closed the connection."""
        self._back.close()

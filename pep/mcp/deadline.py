"""Deadline of a connection: one held open in silence, or fed byte by byte, makes room for others."""

from __future__ import annotations

import asyncio
from typing import Any, Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_S: Final = 5.0
"""Time within which a request must be whole, from the connection's or the request's first byte.

A real client needs milliseconds; another caller's stop may need the room.
"""


class DeadlineProtocol(H11Protocol):
    """HTTP/1.1 for `uvicorn.Config(http=...)` that closes connections whose request does not arrive in time."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as the class itself
        """Starts the clock: nothing has been received yet."""
        super().connection_made(transport)
        self._run_clock()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops the clock for good."""
        self._stop_clock()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Stops the clock when the request is whole; more bytes of the same request do not set it back."""
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._run_clock()
        else:
            self._stop_clock()

    def _run_clock(self) -> None:
        if self._deadline is None:
            self._deadline = asyncio.get_running_loop().call_later(REQUEST_S, self._out_of_time)

    def _stop_clock(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _out_of_time(self, *_: Any) -> None:
        self._deadline = None
        if not self.transport.is_closing():
            self.transport.close()

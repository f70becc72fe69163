"""One HTTP connection with its place and deadlines: held open in silence, or fed byte by byte, it makes room."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from pep.base.caller_place import EXTENSION
from ztpm.edge.places import Standing

if TYPE_CHECKING:
    import asyncio

    from starlette.types import Receive, Scope, Send
    from uvicorn.protocols.http.h11_impl import RequestResponseCycle

    from ztpm.edge.places import ConnectionPlace, Places

REQUEST_S: Final = 5.0
"""Time within which a request must be whole, from the connection's or the request's first byte.

A real client needs milliseconds; another caller's stop may need the room.
"""
ANSWER_S: Final = 10.0
"""Longest standstill of a caller who does not take its answer."""
LINGER_S: Final = 1.0
"""Time for which the rest of a refused request is read and dropped, lest a reset overtakes the answer."""


class PlacedConnection(H11Protocol):
    """HTTP/1.1 that closes connections whose request does not arrive in time, or whose answer nobody takes.

    Args:
        place: of this connection.
        places: where it is one of.
        served: arguments of uvicorn's own protocol.
    """

    def __init__(self, place: ConnectionPlace, places: Places, **served: Any) -> None:
        super().__init__(**served)
        self._place = place
        self._places = places
        self._request_timer: asyncio.TimerHandle | None = None
        self._answer_timer: asyncio.TimerHandle | None = None
        self._refused = False
        self._app = self.app
        self.app = self._placed

    async def _placed(self, scope: Scope, receive: Receive, send: Send) -> None:
        address = self.client[0] if self.client else ""
        scope.setdefault("extensions", {})[EXTENSION] = _Claim(self._places, self._place, address)
        await self._app(scope, receive, send)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as the class itself
        """Starts the clock: nothing has been received yet."""
        super().connection_made(transport)
        self._place.end = transport.abort
        self._run_clock()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops the clocks for good, and frees the place."""
        self._stop_clock()
        self._taken()
        self._places.leave(self._place)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Stops the clock when the request is whole; more bytes of the same request do not set it back."""
        if self._refused:
            return
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._run_clock()
        else:
            self._stop_clock()
            self._turn()

    def send_400_response(self, msg: str) -> None:
        """Refuses bytes that are no request, so that the answer arrives while the rest of them still does."""
        self._refused, transport = True, self.transport
        self.transport = cast("asyncio.Transport", _Unclosed(transport))
        try:
            super().send_400_response(msg)
        finally:
            self.transport = transport
        if transport.can_write_eof():
            transport.write_eof()
            self.loop.call_later(LINGER_S, transport.abort)
        else:  # TLS
            transport.close()

    def on_response_complete(self) -> None:
        """Notes that the connection is silent again, unless the next request is there already."""
        super().on_response_complete()
        self._turn()

    def pause_writing(self) -> None:
        """Starts the clock of an answer that the caller does not take."""
        super().pause_writing()
        if self._answer_timer is None:
            self._answer_timer = self.loop.call_later(ANSWER_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Stops that clock."""
        super().resume_writing()
        self._taken()

    def _turn(self) -> None:
        cycle: RequestResponseCycle | None = self.cycle  # uvicorn's own word for it leaves out that there may be none
        self._places.turn(self._place, busy=cycle is not None and not cycle.response_complete)

    def _run_clock(self) -> None:
        if self._request_timer is None:
            self._request_timer = self.loop.call_later(REQUEST_S, self._out_of_time)

    def _stop_clock(self) -> None:
        if self._request_timer is not None:
            self._request_timer.cancel()
            self._request_timer = None

    def _taken(self) -> None:
        if self._answer_timer is not None:
            self._answer_timer.cancel()
            self._answer_timer = None

    def _out_of_time(self) -> None:
        self._request_timer = None
        if not self.transport.is_closing():
            self.transport.abort()


class _Unclosed:
    """Transport of an answer after which more is still dropped."""

    def __init__(self, transport: asyncio.Transport) -> None:
        self.write = transport.write

    def close(self) -> None:
        """Leaves it open."""


class _Claim:
    """Claims of one request: see `pep.base.caller_place.CallerPlace`."""

    def __init__(self, places: Places, place: ConnectionPlace, address: str) -> None:
        self._places = places
        self._place = place
        self._address = address
        self._claimed = False

    def proven(self, party: str) -> None:
        self._claim(Standing.PARTY, party)

    def stopping(self) -> None:
        self._claim(Standing.STOP, self._address)

    def _claim(self, standing: Standing, owner: str) -> None:
        if not self._claimed:
            self._claimed = True
            self._places.claim(self._place, standing, owner)

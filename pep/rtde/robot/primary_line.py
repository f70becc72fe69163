"""Connection of our own to the primary port: the controller's word on programs, and the way of a stop.

It tells here of each program that starts or ends, from every sender. On one event loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.rtde.robot.connections import PRIMARY
from pep.rtde.robot.program import HEARD_S, event_of
from pep.rtde.robot.reconnecting import ReconnectingConnection
from pep.rtde.wire.primary_frames import PrimaryFrameSplitter

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.rtde.wire.primary_frames import Key

HEARD_MS: Final = round(1000 * HEARD_S)


class PrimaryLine:
    """Connection that comes back by itself after a loss.

    Args:
        host: of the controller.
        clock: the monotonic one counts.
        told: is given each start and end of a program.
        lost: is told that one may have been missed.
    """

    def __init__(self, host: str, *, clock: Clock, told: Callable[[Key], None], lost: Callable[[], None]) -> None:
        self._clock = clock
        self._told = told
        self._tell_lost = lost
        self._robot = ReconnectingConnection(host, PRIMARY, begin=self._begin, heard=self._heard, lost=self._lost)
        self._cutter = PrimaryFrameSplitter()
        self._heard_ms: int | None = None

    async def begin(self) -> None:
        """Listens, or tries to, from now on; returns once connected."""
        await self._robot.begin()

    def close(self) -> None:
        """Ends the connection."""
        self._robot.close()

    @property
    def connected(self) -> bool:
        """True while something can be sent."""
        return self._robot.connected

    @property
    def hears(self) -> bool:
        """True while no start or end is hidden: connected, and not silent for too long."""
        return self._heard_ms is not None and self._clock.monotonic_ms() - self._heard_ms <= HEARD_MS

    def send(self, program: bytes) -> None:
        """Sends to the controller."""
        self._robot.send(program)

    def _begin(self) -> bytes:
        self._cutter = PrimaryFrameSplitter()
        return b""

    def _heard(self, content: bytes) -> None:
        for kind, body in self._cutter.feed(content):
            if (event := event_of(kind, body)) is not None:
                self._told(event)
        self._heard_ms = self._clock.monotonic_ms()

    def _lost(self) -> None:
        self._heard_ms = None
        self._tell_lost()

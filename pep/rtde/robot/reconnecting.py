"""Connection of our own to one port of the controller, on one event loop: it comes back by itself.

A controller whose power is cut says no farewell, and who only listens is never told: so one that has been silent for
too long is lost, as one that was closed.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from pep.rtde.robot.connections import Upstream
from pep.rtde.robot.listener import RETRY_S, SILENCE_S
from pep.rtde.wire.messages import WireError

if TYPE_CHECKING:
    from collections.abc import Callable


class ReconnectingConnection:
    """Connections one after the other.

    Args:
        host, port: of the controller.
        begin: gives what is said first on the next one, of which nothing has been heard yet.
        heard: is given what comes. What it raises as `WireError` ends the connection.
        lost: is told of the end of one, and of each that could not be had.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        begin: Callable[[], bytes],
        heard: Callable[[bytes], None],
        lost: Callable[[], None],
    ) -> None:
        self._where: Final = (host, port)
        self._begin = begin
        self._tell = heard
        self._lost = lost
        self._robot: Upstream | None = None
        self._heard_s = 0.0
        self._over, self._reached = asyncio.Event(), asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def begin(self) -> None:
        """Connects from now on; returns once connected."""
        self._task = asyncio.get_running_loop().create_task(self._keep())
        await self._reached.wait()

    def close(self) -> None:
        """Ends the connection for good."""
        if self._task is not None:
            self._task.cancel()
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()

    @property
    def connected(self) -> bool:
        """True while something can be sent."""
        return self._robot is not None and self._robot.connected

    def send(self, content: bytes) -> None:
        """Sends to the controller."""
        if self._robot is not None:
            self._robot.send(content)

    async def _keep(self) -> None:
        while True:
            robot = self._robot = Upstream(self._heard, self._drop)
            self._over.clear()
            first = self._begin()
            if await robot.reach(*self._where) is None:
                self._heard_s = asyncio.get_running_loop().time()
                robot.send(first)
                self._reached.set()
                await self._ended()
            self._drop()
            await asyncio.sleep(RETRY_S)

    async def _ended(self) -> None:
        """Waits until the connection is over, or silent for too long."""
        loop = asyncio.get_running_loop()
        while not self._over.is_set() and (left_s := self._heard_s + SILENCE_S - loop.time()) > 0:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._over.wait(), left_s)

    def _drop(self) -> None:
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()
            self._over.set()
            self._lost()

    def _heard(self, content: bytes) -> None:
        self._heard_s = asyncio.get_running_loop().time()
        try:
            self._tell(content)
        except WireError:
            self._drop()

"""Connections from a sensor to perception points: frames go out, one per line; nothing comes back."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

RETRY_S: Final = 0.1
UNREAD_BYTES: Final = 65_536
"""Most that waits for a receiver that does not read."""
HANDED_S: Final = 1.0
"""Longest wait of another thread until the loop's own has its line."""


class FrameSender:
    """One perception point, connected to again and again."""

    def __init__(self, host: str, port: int) -> None:
        self._host = host
        self._port = port
        self._writer: asyncio.StreamWriter | None = None
        self.began = asyncio.Event()
        """Set at the first connection."""

    async def keep(self) -> None:
        """Keeps a connection to the receiver whenever it listens, for ever."""
        while True:
            try:
                reader, self._writer = await asyncio.open_connection(self._host, self._port)
                self.began.set()
                await reader.read()  # it says nothing, and ends when it has gone
            except OSError:
                pass
            finally:
                self._drop()
            await asyncio.sleep(RETRY_S)

    @property
    def connected(self) -> bool:
        """True while the receiver is connected."""
        return self._writer is not None

    def send(self, line: bytes) -> bool:
        """Sends a line; True where it was sent.

        Nothing is kept for later: a receiver that does not read is dropped, and connected to anew.
        """
        writer = self._writer
        if writer is None or writer.is_closing():
            return False
        if writer.transport.get_write_buffer_size() > UNREAD_BYTES:
            writer.transport.abort()
            return False
        writer.write(line)
        return True

    def _drop(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


class SenderTasks:
    """Connections to several perception points, on the running event loop."""

    def __init__(self, places: Sequence[tuple[str, int]]) -> None:
        self._loop = asyncio.get_running_loop()
        self._thread = threading.get_ident()
        self._senders = [FrameSender(host, port) for host, port in places]
        self._tasks = [self._loop.create_task(sender.keep()) for sender in self._senders]

    async def connected(self, within_s: float) -> None:
        """Waits so long at most until each was connected to."""
        with suppress(TimeoutError):
            async with asyncio.timeout(within_s):
                for sender in self._senders:
                    await sender.began.wait()

    def send(self, line: bytes) -> int:
        """Number of perception points that the line went to; any thread."""
        if threading.get_ident() == self._thread:
            return self._send(line)
        handed: Future[int] = Future()
        self._loop.call_soon_threadsafe(lambda: handed.set_result(self._send(line)))
        try:
            return handed.result(HANDED_S)
        except TimeoutError:
            return 0

    async def end(self) -> None:
        """Ends all connections."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.sleep(0)  # what was written goes out, then each closes

    def _send(self, line: bytes) -> int:
        return sum(sender.send(line) for sender in self._senders)


class SenderThread:
    """The same on a thread of its own.

    Args:
        places: host and port of each.
        wait_s: longest wait for their first connections.
    """

    def __init__(self, places: Sequence[tuple[str, int]], *, wait_s: float) -> None:
        begun = threading.Event()
        self._ended = asyncio.Event()

        async def live() -> None:
            self._loop, self._tasks = asyncio.get_running_loop(), SenderTasks(places)
            await self._tasks.connected(wait_s)
            begun.set()
            await self._ended.wait()
            await self._tasks.end()

        self._thread = threading.Thread(target=lambda: asyncio.run(live()), name="frames", daemon=True)
        self._thread.start()
        begun.wait()

    def send(self, line: bytes) -> int:
        """Number of perception points that the line went to."""
        return self._tasks.send(line)

    def close(self) -> None:
        """Ends all connections."""
        with suppress(RuntimeError):  # the loop has ended already
            self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()

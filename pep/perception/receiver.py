"""Perception point: sensors push signed frames over TCP, one per line; nothing is ever answered."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from capabilities.statements.observation import FRAME_BYTES
from pep.perception.sensor_frames import NOBODY, FrameFault, RejectedFrame

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.perception.sensor_frames import Frames

CONNECTIONS: Final = 16
"""Senders at once; a cell has a handful of sensors.

Where there are more, the oldest that has sent no believed frame makes room.
"""
FIRST_FRAME_S: Final = 2.0
"""Time for the first believed frame of a sender; one that sends none is no sensor, and makes room."""
STRANGERS: Final = frozenset(
    {FrameFault.MALFORMED, FrameFault.UNKNOWN_SENSOR, FrameFault.UNTRUSTED, FrameFault.TOO_LARGE}
)
"""Faults that only a stranger's frames have.

The connection ends with the first, so that noise costs a connection for each frame.
"""
INCIDENT_PERIOD_MS: Final = 1_000
"""Time within which equal incidents are one record with a count.

A flood of bad frames is then no flood of syncs.
"""


class FrameReceiver:
    """Listens for frames and hands each to the frames' judge.

    Args:
        frames: the judge.
        clock: spaces out the incidents.
        incident: called with (sensor, fault, detail, how many since the last call).
    """

    def __init__(self, frames: Frames, *, clock: Clock, incident: Callable[[str, str, str, int], None]) -> None:
        self._frames = frames
        self._clock = clock
        self._incident = incident
        self._told: dict[tuple[str, str], tuple[int, int]] = {}
        self._server: asyncio.Server | None = None
        self._writers: dict[asyncio.StreamWriter, bool] = {}  # true after a believed frame

    async def listen(self, host: str, port: int) -> int:
        """Receives frames from now on; the port that was bound."""
        self._server = await asyncio.start_server(self._serve, host, port, limit=FRAME_BYTES + 1)
        bound: int = self._server.sockets[0].getsockname()[1]
        return bound

    async def close(self) -> None:
        """Ends the reception."""
        if self._server is not None:
            self._server.close()
            for writer in list(self._writers):
                writer.close()
            await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._writers) >= CONNECTIONS:
            self._tell(RejectedFrame(FrameFault.TOO_MANY_SENDERS, NOBODY))
            stranger = next((each for each, believed in self._writers.items() if not believed), None)
            if stranger is None:
                writer.close()
                return
            del self._writers[stranger]
            stranger.transport.abort()
        self._writers[writer] = False
        try:
            async with asyncio.timeout(FIRST_FRAME_S) as patience:
                while await self._one(reader, writer, patience):  # noqa: ASYNC110 - not a wait: a turn for the others
                    # However much a sender sends, the watch over the moving arm has its turn.
                    await asyncio.sleep(0)
        except (ConnectionError, TimeoutError, asyncio.CancelledError):
            # A sender that goes away is a view that grows old; that is judged where views are read.
            return
        finally:
            self._writers.pop(writer, None)
            writer.close()

    async def _one(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, patience: asyncio.Timeout) -> bool:
        """Judges one line; False when the stream ends, or has to."""
        try:
            line = await reader.readuntil(b"\n")
        except asyncio.IncompleteReadError as error:
            if error.partial:
                self._tell(self._frames.reject(FrameFault.MALFORMED))
            return False
        except asyncio.LimitOverrunError:
            # What follows cannot be told apart from the oversized frame: the connection ends with it.
            self._tell(self._frames.reject(FrameFault.TOO_LARGE))
            return False
        verdict = self._frames.admit(line[:-1])
        if isinstance(verdict, RejectedFrame):
            self._tell(verdict)
            return verdict.fault not in STRANGERS
        patience.reschedule(None)
        if writer in self._writers:
            self._writers[writer] = True
        odd = self._frames.contradiction(verdict)
        if odd is not None:
            self._tell(odd)
        return True

    def _tell(self, rejected: RejectedFrame) -> None:
        """Tells the incident, at most once in a while for the same sensor and fault."""
        # An unregistered name is the sender's choice; counting by it would let every frame be news.
        key = (rejected.sensor if self._frames.knows(rejected.sensor) else "", str(rejected.fault))
        now = self._clock.monotonic_ms()
        told_ms, kept = self._told.get(key, (now - INCIDENT_PERIOD_MS, 0))
        if now - told_ms < INCIDENT_PERIOD_MS:
            self._told[key] = (told_ms, kept + 1)
            return
        if len(self._told) >= 256:
            self._told.clear()
        self._told[key] = (now, 0)
        self._incident(key[0], key[1], rejected.detail, kept + 1)

"""One end of a carriage over a connection: messages in and out, a beat, and one ending.

The same object serves the program's end and the gateway's. It runs in an event loop and is used in that loop alone.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from capabilities.proof.session_frames import End
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault
from pep.rtde.lease.lease import BEAT_MS, SILENCE_MS, LeaseEnding
from pep.rtde.lease.lease_messages import (
    HEAD_BYTES,
    Beat,
    Bytes,
    LeaseMessageError,
    LeaseOver,
    OpenLines,
    SessionFrameSplitter,
    decode,
    delimited,
    encode,
)
from pep.rtde.robot.connections import leave
from pep.rtde.robot.quick_ack import acknowledge

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.proof.session_frames import Session
    from pep.base.ports import Clock
    from pep.rtde.lease.lease_messages import Word

MOST_BYTES: Final = DEFAULT.frame_bytes - HEAD_BYTES
"""Bytes of a connection in one message."""


class LeaseConnection(asyncio.Protocol):
    """One end of a carriage.

    Args:
        session: this end of it.
        asking: whether this is the program's end.
        clock: both clocks.
        heard: is given each word that is to be acted on, beats included. What it raises as `CarriageError` ends the
            carriage.
        ended: is told once, and nothing after it; then the connection is closed already.
        flowing: is told when the other end takes no more (False), and when it does again (True).
    """

    def __init__(
        self,
        session: Session,
        *,
        asking: bool,
        clock: Clock,
        heard: Callable[[Word], None],
        ended: Callable[[LeaseEnding], None],
        flowing: Callable[[bool], None],
    ) -> None:
        self._session = session
        self._asking = asking
        self._lines = OpenLines(asking=asking)
        self._clock = clock
        self._heard = heard
        self._ended = ended
        self._flowing = flowing
        self._cutter = SessionFrameSplitter()
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._silence: asyncio.TimerHandle | None = None
        self._heard_ms = clock.monotonic_ms()
        self._why = LeaseEnding.CLOSED
        self._over = False
        self._unsent: list[bytes] = []

    @property
    def lines(self) -> OpenLines:
        """Lines that are open, for reading alone."""
        return self._lines

    def say(self, word: Word) -> None:
        """Sends a message; bytes in as many messages as they need. After the end, nothing happens.

        Raises:
            CarriageError: it has no meaning now.
        """
        if isinstance(word, Bytes) and len(word.content) > MOST_BYTES:
            for at in range(0, len(word.content), MOST_BYTES):
                self.say(Bytes(word.line, word.content[at : at + MOST_BYTES]))
            return
        if not self._over and self._lines.said(word):
            self._send(self._session.seal(encode(word), at=self._clock.wall_s()))

    def close(self, ending: LeaseEnding = LeaseEnding.CLOSED) -> None:
        """Ends the carriage and tells the other end; the gateway tells the reason."""
        if not self._over:
            if not self._asking:
                self.say(LeaseOver(ending.name))
            self._send(self._session.close(at=self._clock.wall_s()))
        self._end(ending)

    # ---- asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Takes the new connection."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._beat()
        self._listen()

    def data_received(self, data: bytes) -> None:
        """Takes in frames, or parts of some. After the end they are read and dropped."""
        try:
            for frame in self._cutter.feed(b"" if self._over else data):
                self._take(frame)
                if self._over:
                    return
        except LeaseMessageError:
            self.close(LeaseEnding.MALFORMED)
        finally:
            if self._transport is not None and not self._asking:
                acknowledge(self._transport)  # commands; the other direction is not urgent

    def eof_received(self) -> bool:
        """Ends: the other end says nothing more."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Ends: the connection is gone without a message."""
        self._end(LeaseEnding.CUT)

    def pause_writing(self) -> None:
        """Pauses the lines: the other end reads too slowly."""
        self._flowing(False)  # noqa: FBT003 - the one argument there is

    def resume_writing(self) -> None:
        """Resumes the lines: the other end reads again."""
        self._flowing(True)  # noqa: FBT003 - the one argument there is

    # ---- inside

    def _take(self, frame: bytes) -> None:
        match self._session.open(frame, at=self._clock.wall_s()):
            case Fault():
                self.close(LeaseEnding.MALFORMED)
            case End():
                self._end(self._why)
            case message:
                self._heard_ms = self._clock.monotonic_ms()
                word = decode(message.body)
                if not self._lines.heard(word):
                    return
                if isinstance(word, LeaseOver):
                    # A reason that is not known here is one of a younger gateway.
                    self._why = LeaseEnding.__members__.get(word.reason, LeaseEnding.GATEWAY)
                self._heard(word)

    def _send(self, frame: bytes | Fault) -> None:
        if isinstance(frame, Fault):  # the session's time is over
            self._end(LeaseEnding.AUTHORITY)
        else:
            self._unsent.append(delimited(frame))
            if self._asking:
                self._flush()  # a command
            elif len(self._unsent) == 1:
                # What the controller says comes on several lines at once: it goes on, and wakes the other end, once.
                asyncio.get_running_loop().call_soon(self._flush)

    def _flush(self) -> None:
        unsent, self._unsent = self._unsent, []
        if unsent and self._transport is not None and not self._transport.is_closing():
            self._transport.write(b"".join(unsent))

    def _beat(self) -> None:
        if self._over:
            return
        self.say(Beat())
        self._timer = asyncio.get_running_loop().call_later(BEAT_MS / 1000, self._beat)

    def _listen(self) -> None:
        """Ends the carriage when the other end has been silent for too long; else looks again later."""
        if self._over:
            return
        left_ms = SILENCE_MS - (self._clock.monotonic_ms() - self._heard_ms)
        if left_ms < 0:
            self.close(LeaseEnding.SILENT)
        else:
            self._silence = asyncio.get_running_loop().call_later((left_ms + 1) / 1000, self._listen)

    def _end(self, ending: LeaseEnding) -> None:
        if self._over:
            return
        self._flush()
        self._over = True
        for timer in (self._timer, self._silence):
            if timer is not None:
                timer.cancel()
        if self._transport is not None:
            leave(self._transport)
        self._ended(ending)

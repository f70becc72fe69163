"""Whether the program that the controller runs is still the one that we started: the primary port tells of every other.

The controller tells on its primary port (30001) when a program starts and when one ends, whoever sent it and whatever
its name. Together with the input registers, which the controller lends to one client alone, that is what there is to
know about who commands the arm.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from pep.rtde.robot.listener import Listener, received
from pep.rtde.wire.primary_frames import MESSAGE, Key, PrimaryCutter, decode_message

if TYPE_CHECKING:
    import socket
    from collections.abc import Iterator

PORT: Final = 30001  # UR primary interface
OURS: Final = "rtde_control"
"""Name of the control script in ur_rtde's upload."""
HEARD_S: Final = 0.5
"""The port sends the robot's state ten times a second; a port that is silent for longer may hide a start."""
STARTED, STOPPED = "PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"


def event_of(kind: int, body: bytes) -> Key | None:
    """A program's start or end, if that is what a frame of the port tells.

    A state of the robot is not read: what a younger controller says in it is none of ours.

    Raises:
        WireError: a message that contradicts itself.
    """
    content = decode_message(body).content if kind == MESSAGE else None
    return content if isinstance(content, Key) and content.title in (STARTED, STOPPED) else None


class ProgramWatch:
    """Listens for programs that start and end.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        self._changed = threading.Condition()
        self._heard_s: float | None = None
        self._running: str | None = None
        self._events = 0
        self._claimed: int | None = None
        self._listener = Listener("program", host, PORT, self._talk)
        self._listener.start()

    def listening(self, *, within_s: float) -> bool:
        """Whether the port is heard, waited for at most `within_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: self._heard_s is not None, within_s)

    def claim(self, *, within_s: float) -> bool:
        """The running program is taken for ours from now on, if the port has told that one of our name has started.

        Args:
            within_s: how long to wait for that.
        """
        with self._changed:
            told = self._changed.wait_for(lambda: self._running == OURS, within_s)
            self._claimed = self._events if told else None
            return told

    @contextmanager
    def restarted(self, *, within_s: float) -> Iterator[None]:
        """A block in which the program is sent again by us: the one that has started in it is taken for ours.

        Args:
            within_s: how long to wait, after the block, for the port to tell of that start.
        """
        with self._changed:
            before = self._events
        yield
        with self._changed:
            told = self._changed.wait_for(lambda: self._events > before and self._running == OURS, within_s)
            self._claimed = self._events if told else None

    def undisturbed(self) -> bool:
        """Whether nothing has started or ended since `claim`, and nothing that did can have been missed."""
        with self._changed:
            heard_s = self._heard_s
            return (
                heard_s is not None
                and time.monotonic() - heard_s <= HEARD_S
                and self._claimed is not None
                and self._claimed == self._events
            )

    def close(self) -> None:
        """The connection has ended."""
        self._listener.close()

    def _talk(self, link: socket.socket) -> None:
        cutter = PrimaryCutter()
        try:
            while True:
                for kind, body in cutter.feed(received(link)):
                    self._heard(event_of(kind, body))
        finally:
            # What happens now is not heard: only a new start of ours, or a new claim, makes the program ours again.
            with self._changed:
                self._heard_s = self._running = self._claimed = None

    def _heard(self, event: Key | None) -> None:
        with self._changed:
            self._heard_s = time.monotonic()
            if event is not None:
                self._events += 1
                self._running = event.text if event.title == STARTED else None
            self._changed.notify_all()

"""Tap on the attacked sensor's stream: an eavesdropper who keeps its frames."""

from __future__ import annotations

import json
import socket
import threading
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from capabilities.keys import keys
from ztpm.cell.setup import SENSOR_ID

if TYPE_CHECKING:
    from ztpm.cell.cell import Cell

KEPT: Final = 900
"""Frames that are kept: half a minute of a stream."""
LOOPBACK: Final = "127.0.0.1"


class FrameTap:
    """Second receiver of a cell's first sensor; the sensors are begun anew for it.

    Args:
        cell: whose sensors they are.
    """

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._frames: deque[str] = deque(maxlen=KEPT)
        self._again = 0
        self._server = socket.create_server((LOOPBACK, 0))
        threading.Thread(target=self._listen, name="tap", daemon=True).start()
        self.begin_sensor()

    def begin_sensor(self) -> None:
        """Begins the sensors anew: they see an empty scene."""
        self._cell.start_sensor("--to", f"{LOOPBACK}:{self._server.getsockname()[1]}")

    def newest(self) -> str | None:
        """The newest frame, or None before the first."""
        return self._frames[-1] if self._frames else None

    def earlier(self, people: int, objects: int) -> str | None:
        """Earlier frame with so many people and objects, another at each call; None where there is none."""
        these = [frame for frame in tuple(self._frames)[:-1] if shown(frame) == (people, objects)]
        if not these:
            return None
        self._again += 1
        return these[self._again % len(these)]

    def close(self) -> None:
        """Ends it."""
        self._server.close()

    def _listen(self) -> None:
        while True:
            try:
                line, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._keep, args=(line,), name="tapped", daemon=True).start()

    def _keep(self, line: socket.socket) -> None:
        with line, line.makefile("r", encoding="ascii") as frames:
            for frame in frames:
                if _claims(frame)["sensor"] == SENSOR_ID:
                    self._frames.append(frame.rstrip("\n"))


def shown(frame: str) -> tuple[int, int]:
    """Number of people and of objects that a frame shows, unverified."""
    claims = _claims(frame)
    return len(claims["people"]), len(claims["objects"])


def _claims(frame: str) -> dict[str, Any]:
    claims: dict[str, Any] = json.loads(keys.unb64u(frame.split(".")[1]))
    return claims

"""Thread that keeps a connection to the controller: it listens until closed, and reconnects after a loss."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from pep.base.errors import RobotError
from pep.rtde.wire.messages import WireError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.subscription import Subscription

CONNECT_S: Final = 2.0
SILENCE_S: Final = 1.0
"""Silence of a controller that owes an answer, after which it is asked anew over a new connection."""
RETRY_S: Final = 0.5


class Listener:
    """One connection in the background.

    Args:
        name: of the thread.
        host, port: of the controller.
        talk: speaks and listens until the connection breaks (it raises `OSError`, `WireError` or `RobotError`), or
            returns to begin anew.
    """

    def __init__(self, name: str, host: str, port: int, talk: Callable[[socket.socket], None]) -> None:
        self._where = (host, port)
        self._talk = talk
        self._link: socket.socket | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Listens from now on."""
        self._thread.start()

    def pause(self, seconds: float) -> bool:
        """Waits for `seconds`, or until it is being closed: then False."""
        return not self._ending.wait(seconds)

    def close(self) -> None:
        """Ends the connection, and the thread with it."""
        self._ending.set()
        link = self._link
        if link is not None:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        if self._thread.is_alive():
            self._thread.join(CONNECT_S + SILENCE_S)

    def _run(self) -> None:
        while not self._ending.is_set():
            with suppress(OSError, WireError, RobotError), socket.create_connection(self._where, CONNECT_S) as link:
                link.settimeout(SILENCE_S)
                self._link = link
                self._talk(link)
            self._link = None
            self._ending.wait(RETRY_S)


def received(link: socket.socket) -> bytes:
    """Bytes that arrived next, never empty.

    Raises:
        OSError: nothing did, or the other side has closed the connection.
    """
    piece = link.recv(65_536)
    if not piece:
        raise ConnectionResetError("closed by the controller")
    return piece


def packages(link: socket.socket, subscription: Subscription) -> Iterator[dict[str, Value]]:
    """Packages of the subscription, without end.

    Raises:
        OSError: as `received`.
        WireError: as `Subscription.feed`; a name that the controller does not know, say.
    """
    link.sendall(subscription.begin())
    while True:
        said, came = subscription.feed(received(link))
        if said:
            link.sendall(said)
        yield from came

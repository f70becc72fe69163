"""The newest package of some of the controller's outputs, over a connection of our own that comes back by itself."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from pep.rtde.listener import Listener, received
from pep.rtde.messages import WireError, WireFault
from pep.rtde.subscription import Subscription

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from pep.rtde.codec import Value

PORT: Final = 30004  # RTDE

T = TypeVar("T")


class Packages(Generic[T]):
    """Of one connection. From any thread; a package older than its reader bears is its reader's to tell.

    Args:
        name: of the thread.
        host: of the controller.
        names: of the outputs; one that the controller does not know leaves this without a package.
        rate_hz: how often.
        read: what a package says, by its values and its monotonic time of arrival in s; None for one that is dropped.
    """

    def __init__(
        self,
        name: str,
        host: str,
        names: tuple[str, ...],
        rate_hz: float,
        *,
        read: Callable[[dict[str, Value], float], T | None],
    ) -> None:
        self._names, self._rate_hz = names, rate_hz
        self._read = read
        self._newest: T | None = None
        self._count = 0
        self._came = threading.Condition()
        self._listener = Listener(name, host, PORT, self._talk)
        self._listener.start()

    @property
    def newest(self) -> T | None:
        """The newest, however old; None before the first."""
        return self._newest

    def next(self, *, within_s: float) -> T | None:
        """One that arrives after this call has begun; None where none does within `within_s`."""
        with self._came:
            count = self._count
            return self._newest if self._came.wait_for(lambda: self._count != count, within_s) else None

    def close(self) -> None:
        """The connection has ended."""
        self._listener.close()

    def _talk(self, link: socket.socket) -> None:
        subscription = Subscription(self._names, self._rate_hz)
        link.sendall(subscription.begin())
        while True:
            said, packages = subscription.feed(received(link))
            if said:
                link.sendall(said)
            for values in packages:
                self._take(self._read(values, time.monotonic()))

    def _take(self, package: T | None) -> None:
        if package is not None:
            with self._came:
                self._newest = package
                self._count += 1
                self._came.notify_all()


def vector(value: Value) -> tuple[float, ...]:
    """An output that the controller's tables promise to be a vector.

    Raises:
        WireError: it is none.
    """
    if not isinstance(value, tuple):
        raise WireError(WireFault.PAYLOAD, "a vector was promised")
    return tuple(map(float, value))


def number(value: Value) -> float:
    """One that they promise to be a number.

    Raises:
        WireError: it is none.
    """
    if isinstance(value, tuple):
        raise WireError(WireFault.PAYLOAD, "a number was promised")
    return value

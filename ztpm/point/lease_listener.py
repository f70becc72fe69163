"""Listener of a robot's lease port: connections that have not named their lease have places by address."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ztpm.edge.listener import Listener, bound
from ztpm.edge.places import Bounds, Places

if TYPE_CHECKING:
    import asyncio

    from pep.rtde.lease.lease_port import LeasePort
    from ztpm.edge.places import ConnectionPlace

WAITING: Final = Bounds(strangers=64, by_address=16)
"""Most connections that wait for their id; one that is carried is the lease's, of which there is one."""


class LeaseListener:
    """Listener for carriages.

    Args:
        port: port of the leases.
        bounds: most connections that wait.

    Attributes:
        places: places of those that wait.
    """

    def __init__(self, port: LeasePort, *, bounds: Bounds = WAITING) -> None:
        self._port = port
        self.places = Places(bounds)
        self._listeners: list[Listener] = []

    async def listen(self, host: str, port: int) -> None:
        """Listens from now on.

        Raises:
            OSError: the address cannot be had.
        """
        self._listeners = [
            Listener(each, places=self.places, protocol=self._door, tls=None) for each in bound(host, port)
        ]

    def close(self) -> None:
        """Accepts nothing more."""
        for listener in self._listeners:
            listener.close()

    def _door(self, place: ConnectionPlace) -> asyncio.Protocol:
        def made(transport: asyncio.Transport) -> None:
            place.end = transport.abort

        return self._port.door(made=made, over=lambda: self.places.leave(place))

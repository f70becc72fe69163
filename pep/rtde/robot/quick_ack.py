"""Immediate acknowledgement of bytes that arrive on a connection.

Linux puts an acknowledgement off until there is something to send back, and holds a small message back while an earlier
one of the same connection is not acknowledged (`tcp_autocorking`): of a stream of commands each then waits for the next
package of outputs, up to a whole cycle of the controller, under all settings of its sender.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio


def acknowledge(transport: asyncio.Transport) -> None:
    """Acknowledges all bytes so far.

    The system forgets the setting: to be called for each piece.
    """
    sock: socket.socket | None = transport.get_extra_info("socket")
    if sock is not None and not transport.is_closing():
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)

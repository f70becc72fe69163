"""User of the process at a connection's other end on this machine, by the kernel's table of sockets."""

from __future__ import annotations

import ipaddress
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import socket

TABLE: Final = Path("/proc/net/tcp")
"""IPv4 sockets alone, proc(5)."""
ESTABLISHED: Final = "01"
"""A socket that is being closed may have left its owner already."""
_LOCAL, _REMOTE, _STATE, _USER = 1, 2, 3, 7
"""Columns of the table."""


def owner_of(near: tuple[str, int], far: tuple[str, int], *, table: Path = TABLE) -> int | None:
    """The user id that owns the far end of an established IPv4 connection from this machine to itself.

    Args:
        near: address and port at this end.
        far: address and port at the other end.
        table: the kernel's.

    Returns:
        None for a connection that the table does not hold: an ended one, one from another machine, another family.
    """
    try:
        wanted = [_spelled(far), _spelled(near)]  # their socket: its local address is our remote one
        rows = table.read_text(encoding="ascii").splitlines()[1:]
    except (OSError, ValueError):
        return None
    for row in rows:
        cells = row.split()
        if cells[_LOCAL : _REMOTE + 1] == wanted and cells[_STATE] == ESTABLISHED:
            return int(cells[_USER])
    return None


def user_of(link: socket.socket) -> int | None:
    """The owner of the far end of this connection; None as for `owner_of`."""
    try:
        near, far = link.getsockname(), link.getpeername()
    except OSError:
        return None
    return owner_of(near[:2], far[:2]) if isinstance(near, tuple) and isinstance(far, tuple) else None


def _spelled(end: tuple[str, int]) -> str:
    """An IPv4 address in the machine's byte order and a port, in hex, as the kernel writes them."""
    number = int.from_bytes(ipaddress.IPv4Address(end[0]).packed, sys.byteorder)
    return f"{number:08X}:{end[1]:04X}"

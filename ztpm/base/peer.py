"""Whose process is at the other end of a connection on this machine."""

from __future__ import annotations

import ipaddress
import socket
import sys
from pathlib import Path
from typing import Final

TABLE: Final = Path("/proc/net/tcp")
_ESTABLISHED: Final = "01"
_LOCAL, _REMOTE, _STATE, _USER = 1, 2, 3, 7
"""Columns of the table (proc(5))."""


def user_of(link: socket.socket) -> int | None:
    """The user id of the process at the other end of an IPv4 connection from this machine to itself.

    The kernel's table of connections names the user of each socket. None for a connection that is not there (any more),
    from another machine, or of another family: unknown is nobody.
    """
    try:
        here, there = link.getsockname(), link.getpeername()
        table = TABLE.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return None
    if link.family is not socket.AF_INET:
        return None
    wanted = (_text(there), _text(here))  # their socket: its local address is our remote one
    for row in table.splitlines()[1:]:
        columns = row.split()
        if (columns[_LOCAL], columns[_REMOTE]) == wanted and columns[_STATE] == _ESTABLISHED:
            return int(columns[_USER])
    return None


def _text(address: tuple[str, int]) -> str:
    """As the table writes an address: the bytes in this machine's order."""
    host, port = address
    number = int.from_bytes(ipaddress.IPv4Address(host).packed, sys.byteorder)
    return f"{number:08X}:{port:04X}"

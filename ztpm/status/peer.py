"""Whose process is at the other end of a loopback connection: the kernel's table of sockets says so."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Final

TABLE: Final = Path("/proc/net/tcp")
"""proc(5): columns 1 and 2 are the local and the remote address, column 7 the user id of the socket's owner."""
LOCAL, REMOTE, OWNER = 1, 2, 7


def owner_of(near: tuple[str, int], far: tuple[str, int], *, table: Path = TABLE) -> int | None:
    """The user id that owns the far end of a TCP connection over IPv4 loopback, or None when it is not found.

    Args:
        near: address and port at this end.
        far: address and port at the other end.
        table: the kernel's.
    """
    try:
        wanted = [_spelled(far), _spelled(near)]
        rows = table.read_text("ascii").splitlines()[1:]
    except (OSError, ValueError):
        return None
    for row in rows:
        cells = row.split()
        if cells[LOCAL : REMOTE + 1] == wanted:
            return int(cells[OWNER])
    return None


def _spelled(end: tuple[str, int]) -> str:
    """An IPv4 address in the machine's byte order and a port, in hex, as the kernel writes them."""
    import sys

    packed = ipaddress.IPv4Address(end[0]).packed
    return f"{int.from_bytes(packed, sys.byteorder):08X}:{end[1]:04X}"

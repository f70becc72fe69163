"""Addresses of this machine alone.

A robot's ports are fixed, so each program that serves them needs an address of its own.
"""

from __future__ import annotations

import hashlib
import socket
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

TRIES: Final = 64


def free_host(seed: bytes, free: Callable[[str], bool]) -> str:
    """A loopback address that is free now.

    Args:
        seed: random bytes; decides the order in which addresses are tried.
        free: whether an address is.

    Raises:
        OSError: when `TRIES` addresses in a row are taken.
    """
    for attempt in range(TRIES):
        draw = hashlib.sha256(seed + bytes([attempt])).digest()
        host = f"127.{64 + draw[0] % 63}.{draw[1]}.{1 + draw[2] % 254}"
        if free(host):
            return host
    raise OSError("no free loopback address")


def is_free(host: str, port: int) -> bool:
    """True where no program listens there now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True

"""Places of TCP listeners, as people write them: HOST:PORT, the host of IPv6 in brackets."""

from __future__ import annotations

from typing import Final

from pep.base.errors import ConfigError, PepFault

PORT_MOST: Final = 65_535
_DIGITS: Final = len(str(PORT_MOST))


def tcp_place(text: str, *, name: str) -> tuple[str, int]:
    """Host, without brackets, and port from 1 to 65535.

    Args:
        text: as it was written.
        name: of the setting or argument, for the fault.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    host, _, port = text.rpartition(":")
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= _DIGITS else 0
    if not bare or set(bare) & set("[]") or not 1 <= number <= PORT_MOST:
        raise ConfigError(
            PepFault.CONFIG_INVALID, f"{name}: {text[:64]!r} is not HOST:PORT, such as 127.0.0.1:8950 or [::1]:8950"
        )
    return bare, number
